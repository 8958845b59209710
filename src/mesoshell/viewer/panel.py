"""The sliders of one material on a viewer's page."""

from collections.abc import Callable, Collection
from typing import Any

from mesoshell.io.bundle import Parameter
from mesoshell.scene.scene import Grown, Scene
from mesoshell.viewer.look import PartLook, is_generated


class Panel:
    """A folder of a server's page with the parameters, the seed, the thickness and the scale of a material of a scene. look:
    what is set of it; changed: called when one is set."""

    def __init__(self, gui: Any, part: Scene | Grown, look: PartLook, title: str, changed: Callable[[Any], None]):
        material = part.material
        self.folder = gui.add_folder(title)
        with self.folder:
            self.params = {n: _slider(gui, n, material.parameters[n], value) for n, value in look.params.items()}
            tiled = not is_generated(part) and getattr(material.bundle, "tiles", None) is not None
            self._seed, self._toward, self._share, self._thickness, self._scale = (None,) * 5
            if is_generated(part) or tiled:
                self._seed = gui.add_number("seed", look.seed, min=-(2**31), max=2**32 - 1, step=1)
            if is_generated(part) and material.shell.latent_size:
                toward, share = look.latent or (look.seed + 1 if look.seed < 2**32 - 1 else 0, 0.0)
                hint = "whose latent z the seed's can go toward"
                self._toward = gui.add_number("other seed", toward, min=-(2**31), max=2**32 - 1, step=1, hint=hint)
                hint = "0: z of the seed; 1: z of the other seed; phases stay the seed's"
                self._share = gui.add_slider("share of its z", 0.0, 1.0, 0.05, share, hint=hint)
            if (t := look.thickness) is not None:
                hint = "height of the shell, in the mesh's unit"
                self._thickness = gui.add_slider("thickness", t / 10, t * 3, t / 50, t, hint=hint)
            if (s := look.scale) is not None:
                hint = "length of one patch, in the mesh's unit" + ("; grows another" if is_generated(part) else "")
                self._scale = gui.add_slider("scale", s / 3, s * 3, s / 60, s, hint=hint)
            self._bar = gui.add_progress_bar(0.0, visible=False)
        for each in (*self.params.values(), self._seed, self._toward, self._share, self._thickness, self._scale):
            if each is not None:
                each.on_update(changed)

    def look(self) -> dict[str, Any]:
        """Fields of a `PartLook`."""
        return {
            "params": {name: float(slider.value) for name, slider in self.params.items()},
            "seed": 0 if self._seed is None else int(self._seed.value),
            "latent": self._latent(),
            "thickness": None if self._thickness is None else float(self._thickness.value),
            "scale": None if self._scale is None else float(self._scale.value),
        }

    def _latent(self) -> tuple[int, float] | None:
        if self._toward is None or self._share is None or not self._share.value:
            return None
        return int(self._toward.value), float(self._share.value)

    def rest(self, painted: Collection[str]) -> None:
        """A painted parameter's slider rests."""
        for name, slider in self.params.items():
            slider.disabled = name in painted

    def grown(self, share: float) -> None:
        """Show how much of a texture is grown."""
        self._bar.visible = share < 1
        self._bar.value = 100 * share


def _slider(gui: Any, name: str, parameter: Parameter, value: float) -> Any:
    low, high = parameter.range
    unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
    hint = f"{parameter.meaning} (default {parameter.default:g})"
    return gui.add_slider(name + unit, low, high, (high - low) / 200, min(max(value, low), high), hint=hint)
