"""The drawings of docs/concepts, a function each: `python docs/images/drawings/draw.py` writes NAME.svg beside this file."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse, FancyArrowPatch, FancyBboxPatch, Polygon
from numpy.typing import ArrayLike

INK, PALE, GREEN, RED, BLUE, GOLD = "#333333", "#bbbbbb", "#4a8f3c", "#c0392b", "#2c6fad", "#d4a017"


def arrow(ax: Axes, a: ArrayLike, b: ArrayLike, colour: str = INK, style: str = "-|>", **how) -> None:
    ends = [tuple(x) for x in np.array([a, b])]
    ax.add_patch(FancyArrowPatch(ends[0], ends[1], arrowstyle=style, mutation_scale=11, color=colour, lw=1.3, **how))


def box(ax: Axes, at: tuple, size: tuple, text: str, colour: str = BLUE) -> None:
    """A named box with its middle at `at`."""
    corner = at[0] - size[0] / 2, at[1] - size[1] / 2
    style = "round,pad=0,rounding_size=0.06"
    ax.add_patch(FancyBboxPatch(corner, *size, boxstyle=style, fc=colour + "22", ec=colour, lw=1.2))
    ax.text(*at, text, ha="center", va="center", fontsize=9)


def flat(ax: Axes, x: tuple, y: tuple, title: str = "") -> None:
    ax.set(xlim=x, ylim=y, aspect="equal")
    ax.set_axis_off()
    ax.set_title(title, fontsize=10)


def shell(figure) -> None:
    """Prisms over a surface and a ray through them; one prism, whose sides are bilinear patches."""
    ax = figure.add_subplot(1, 2, 1)
    x = np.linspace(0, 4, 6)
    base = np.stack([x, 0.35 * np.sin(1.3 * x)], 1)
    slope = 0.35 * 1.3 * np.cos(1.3 * x)
    post = 0.9 * np.stack([-slope, np.ones_like(x)], 1) / np.hypot(slope, 1)[:, None]
    top = base + post
    for k in range(5):
        corners = [base[k], base[k + 1], top[k + 1], top[k]]
        ax.add_patch(Polygon(corners, fc=GREEN + "22", ec=PALE))
    ax.plot(*base.T, color=INK, lw=2)
    ax.plot(*top.T, color=GREEN, lw=2)
    eye, end = np.array([-0.35, 1.75]), np.array([3.62, -0.305])
    arrow(ax, eye, end, RED)
    crossings = []
    for a, b in [*pairwise(top), *zip(base, top, strict=True)]:
        t, s = np.linalg.solve(np.stack([end - eye, a - b], 1), a - eye)
        if 0 <= t <= 1 and 0 <= s <= 1:
            crossings.append(eye + t * (end - eye))
    ax.plot(*np.array([*crossings, end]).T, "o", color=RED, ms=4)
    ax.text(-0.5, 1.85, "o, d", color=RED)
    ax.text(2.0, -0.62, "base surface, h = 0", ha="center", fontsize=9)
    ax.text(3.1, 1.25, "top, h = 1", ha="center", fontsize=9, color=GREEN)
    flat(ax, (-0.8, 4.6), (-0.8, 2.1), "one interval a prism")
    ax = figure.add_subplot(1, 2, 2, projection="3d")
    p = np.array([[0, 0, 0], [1.2, 0.1, 0], [0.4, 1.1, 0]])
    n = np.array([[-0.25, -0.3, 1], [0.3, -0.25, 1.05], [0.05, 0.4, 0.95]])
    loop = [0, 1, 2, 0]
    ax.plot(*p[loop].T, color=INK, lw=2)
    ax.plot(*(p + n)[loop].T, color=GREEN, lw=2)
    for k in range(3):
        ax.plot(*np.stack([p[k], p[k] + n[k]]).T, color=PALE)
    u, h = np.meshgrid(np.linspace(0, 1, 7), np.linspace(0, 1, 7))
    side = (1 - u)[..., None] * p[0] + u[..., None] * p[1]
    side = side + h[..., None] * ((1 - u)[..., None] * n[0] + u[..., None] * n[1])
    ax.plot_wireframe(*np.moveaxis(side, -1, 0), color=BLUE, lw=0.6)
    at = 0.4 * p[0] + 0.6 * p[1] + 0.5 * (0.4 * n[0] + 0.6 * n[1])
    way = np.array([0.25, -0.9, -0.1])
    ax.plot(*np.stack([at - 0.9 * way, at]).T, color=RED, lw=1, ls=":")
    ax.plot(*np.stack([at, at + 1.1 * way]).T, color=RED, lw=1.8)
    ax.scatter(*at, color=RED, s=18)
    ax.text(*(at + np.array([0.1, -0.1, 0.06])), "P(u, h)", color=RED)
    for k, name in ((0, "p₀"), (1, "p₁")):
        ax.text(*(p[k] + np.array([-0.12, 0, -0.14])), name)
        ax.text(*(p[k] + n[k] + np.array([-0.1, 0, 0.07])), f"{name} + n{'₀₁'[k]}")
    ax.set_axis_off()
    ax.view_init(18, -68)
    ax.set_box_aspect((1.6, 1.5, 1.3), zoom=1.35)
    ax.set_title("a side is a bilinear patch", fontsize=10)


def filtering(figure) -> None:
    """A pixel's cone, the Gaussian of a piece of it, its ellipse on the tangent plane, and the level that r picks."""
    ax = figure.add_subplot(1, 2, 1)
    eye, aim = np.array([-0.2, 2.6]), np.array([4.1, 0.3])
    d = (aim - eye) / np.linalg.norm(aim - eye)
    side = np.array([-d[1], d[0]])
    far = eye + 5.0 * d
    ax.add_patch(Polygon([eye, far + 0.36 * side, far - 0.36 * side], fc=RED + "18", ec=RED, lw=0.8))
    angle = np.degrees(np.arctan2(d[1], d[0]))
    for t in (3.0, 3.6, 4.2):
        ax.add_patch(Ellipse(tuple(eye + t * d), 0.55, 0.11 * t, angle=angle, fc=RED + "44", ec=RED, lw=0.8))
    ax.plot([0.6, 4.7], [0, 0], color=INK, lw=2)
    ax.plot([0.6, 4.7], [1.3, 1.3], color=GREEN, lw=2)
    at = eye + 3.6 * d
    ax.plot([at[0]] * 2, [0, at[1]], color=PALE, ls="--")
    ax.plot([at[0] - 0.27, at[0] + 0.27], [0, 0], color=BLUE, lw=5)
    ax.text(at[0], -0.32, "ellipse a ≥ b on the tangent plane", color=BLUE, ha="center", fontsize=9)
    ax.text(at[0] + 0.2, at[1] + 0.25, "μ, Σ", color=RED)
    ax.annotate("", (4.55, at[1] + 0.14), (4.55, at[1] - 0.14), arrowprops={"arrowstyle": "<->", "color": GREEN})
    ax.text(4.62, at[1], "$\\sigma_h$", color=GREEN, va="center")
    flat(ax, (-0.4, 5.1), (-0.6, 2.8), "a pixel is a cone")
    ax = figure.add_subplot(1, 2, 2)
    for level in range(4):
        n, y = 8 >> level, 2.1 - 0.72 * level
        for i in range(n):
            ax.add_patch(
                Polygon(
                    [(i * 3 / n, y), ((i + 1) * 3 / n, y), ((i + 1) * 3 / n, y + 0.5), (i * 3 / n, y + 0.5)],
                    fc=mpl.colormaps["Greens"](0.25 + 0.5 * ((i * 5 + level * 3) % 7) / 7),
                    ec="white",
                )
            )
        ax.text(3.1, y + 0.25, f"level {level}", va="center", fontsize=9)
    middle = 5.1, 1.3
    ax.add_patch(Ellipse(middle, 1.6, 0.8, fc=BLUE + "22", ec=BLUE, lw=1.6))
    arrow(ax, middle, (5.9, 1.3), BLUE, shrinkA=0, shrinkB=0)
    arrow(ax, middle, (5.1, 1.7), BLUE, shrinkA=0, shrinkB=0)
    ax.text(5.5, 1.12, "a", color=BLUE, ha="center", va="center", fontsize=9)
    ax.text(5.1, 1.78, "r = b", color=BLUE, ha="center", fontsize=9)
    flat(ax, (-0.1, 6.1), (-0.3, 2.8), "level = log₂(2 r · texels a patch)")


def transport(figure) -> None:
    """A collision at y: what lies before it dims it, and ρ holds every path inside the shell from the light to y."""
    ax = figure.add_subplot(1, 1, 1)
    ax.fill_between([0, 8], 0, 2, color=GREEN + "18")
    ax.plot([0, 8], [0, 0], color=INK, lw=2)
    ax.plot([0, 8], [2, 2], color=GREEN, lw=2)
    y, x, z = np.array([4.2, 0.9]), np.array([2.51, 2.0]), np.array([6.3, 2.0])
    arrow(ax, y, (0.9, 3.05), BLUE)
    ax.plot(*np.stack([x, y]).T, "o", color=BLUE, ms=5)
    ax.text(0.6, 3.1, "to the viewer, ω", color=BLUE, fontsize=9)
    ax.text(x[0] + 0.08, 2.1, "x", color=BLUE)
    ax.text(y[0] - 0.05, 0.55, "y", color=BLUE)
    ax.text(2.75, 1.15, "T(x, y)", color=BLUE, fontsize=9)
    for k, way in enumerate(([5.0, 0.5], [5.3, 1.3], [4.6, 1.55])):
        enters = 5.3 + 0.75 * k
        points = np.array([(enters, 2.0), (way[0] + 0.35 * k, way[1]), y])
        ax.plot(*points.T, color=GOLD, lw=1.3)
        arrow(ax, (enters + 0.55, 3.0), (enters, 2.0), GOLD)
    ax.text(6.0, 3.1, "distant light $L_i$(ω′)", color=GOLD, fontsize=9)
    ax.text(5.95, 0.75, "ρ(y, ω, ω′): all of these paths", color=GOLD, fontsize=9)
    ax.text(z[0] + 0.75, 2.1, "z: does it see the light?", color=GOLD, fontsize=9)
    arrow(ax, y, (5.6, -0.2), PALE, ls="--")
    ax.text(5.65, -0.35, "uncollided: goes on, dimmed by T", color=INK, fontsize=9)
    flat(ax, (0, 9.2), (-0.6, 3.4))


def generator(figure) -> None:
    """From noise to σ and ρ: what is generated once, and what is asked at every sample."""
    ax = figure.add_subplot(1, 1, 1)
    box(ax, (0.8, 2.6), (1.1, 0.55), "latent z", GOLD)
    box(ax, (0.8, 1.75), (1.1, 0.55), "geometry β", GOLD)
    box(ax, (2.6, 2.2), (1.2, 0.7), "mapping\nnetwork")
    arrow(ax, (1.4, 2.6), (2.0, 2.35))
    arrow(ax, (1.4, 1.75), (2.0, 2.05))
    for k in range(3):
        x = 4.3 + 1.25 * k
        box(ax, (x, 1.2), (0.95, 0.75), f"layer {'12L'[k]}")
        box(ax, (x, 0.05), (0.95, 0.5), f"Γ{'₁₂ₗ'[k]}, φ", GOLD)
        arrow(ax, (x, 0.32), (x, 0.8))
        arrow(ax, (x, 2.2), (x, 1.6), BLUE)
        if k:
            arrow(ax, (x - 0.77, 1.2), (x - 0.5, 1.2))
    ax.plot([3.2, 8.4], [2.2, 2.2], color=BLUE, lw=1.3)
    ax.text(3.3, 2.28, "w: styles", color=BLUE, fontsize=9)
    ax.text(2.1, -0.02, "phases drawn a texture,\nfrequencies kept", fontsize=8, ha="center", va="center")
    box(ax, (8.4, 1.2), (1.1, 0.75), "F(u, v)", GREEN)
    arrow(ax, (7.3, 1.2), (7.83, 1.2))
    box(ax, (8.4, 2.75), (1.1, 0.5), "F(h)", GREEN)
    arrow(ax, (8.4, 2.2), (8.4, 2.48), BLUE)
    ax.plot([9.25, 9.25], [-0.3, 3.2], color=PALE, ls="--")
    ax.text(5.6, 3.15, "once a texture", ha="center", fontsize=9)
    ax.text(11.2, 3.15, "once a sample", ha="center", fontsize=9)
    ax.text(9.55, 1.95, "+", ha="center", va="center", fontsize=14)
    arrow(ax, (8.97, 1.3), (9.45, 1.85))
    arrow(ax, (8.97, 2.7), (9.45, 2.08))
    box(ax, (10.7, 1.95), (1.1, 0.7), "trunk")
    arrow(ax, (9.68, 1.95), (10.13, 1.95))
    box(ax, (10.7, 0.75), (1.5, 0.5), "h, appearance α", GOLD)
    arrow(ax, (10.7, 1.02), (10.7, 1.58))
    box(ax, (12.5, 1.35), (1.0, 0.7), "head")
    arrow(ax, (11.27, 1.85), (11.98, 1.45))
    box(ax, (12.5, 0.25), (1.0, 0.5), "ω, ω′", GOLD)
    arrow(ax, (12.5, 0.52), (12.5, 0.98))
    arrow(ax, (11.27, 2.1), (13.3, 2.5))
    arrow(ax, (13.02, 1.35), (13.5, 1.35))
    ax.text(13.4, 2.5, "σ", va="center", fontsize=13, color=RED)
    ax.text(13.6, 1.35, "ρ", va="center", fontsize=13, color=RED)
    flat(ax, (0.1, 14), (-0.4, 3.4))


def silhouettes(figure) -> None:
    """One query where a ray meets the bounding surface: a ray may pass between what lies beneath it."""
    ax = figure.add_subplot(1, 2, 1)
    angle = np.radians(np.linspace(20, 160, 80))
    ax.plot(3 * np.cos(angle), 3 * np.sin(angle), color=BLUE, lw=1.6)
    for a in np.radians(np.arange(29.5, 152, 11)):
        ax.add_patch(Ellipse((2.74 * np.cos(a), 2.74 * np.sin(a)), 0.46, 0.46, fc=GOLD + "66", ec=GOLD))
    arrow(ax, (-3.0, 3.25), (-1.0, 2.6), RED)
    ax.text(-3.0, 3.35, "α = 1", color=RED)
    arrow(ax, (-2.4, 2.975), (2.9, 2.975), GREEN)
    ax.text(1.5, 3.1, "α = 0: goes on", color=GREEN)
    ax.plot([0, 0], [0.9, 3], color=PALE, ls="--")
    ax.text(0.08, 1.3, "1/κ")
    ax.text(-1.9, 1.05, "bounding\nsurface", color=BLUE, fontsize=9)
    flat(ax, (-3.2, 3.6), (0.7, 3.6), "the material lies under the surface")
    ax = figure.add_subplot(1, 2, 2)
    for k, (name, gives) in enumerate((("opacity", "α"), ("offset", "u′"), ("reflectance", "ρ"))):
        y = 2.2 - 0.95 * k
        box(ax, (1.1, y), (1.5, 0.55), f"texture $T_{('α', 'd', 'ρ')[k]}$", GREEN)
        box(ax, (3.2, y), (1.5, 0.55), name)
        arrow(ax, (1.87, y), (2.42, y))
        arrow(ax, (3.97, y), (4.5, y))
        ax.text(4.6, y, gives, va="center", fontsize=11, color=RED)
        ax.text(1.1, y + 0.33, "at u" if k < 2 else "at u′", ha="center", fontsize=8)
        ax.text(3.2, y + 0.33, "ω, κ" if k < 2 else "ω, ω′, κ", ha="center", fontsize=8)
    flat(ax, (0.2, 5.1), (-0.2, 2.8), "three small networks")


def capture(figure) -> None:
    """A ray through the volume: density where it is, colour by way of the sphere; and back again, where the ray ends."""
    ax = figure.add_subplot(1, 1, 1)
    ax.add_patch(Polygon([(1.2, 0), (4.6, 0), (4.6, 3), (1.2, 3)], fc="none", ec=PALE))
    ax.add_patch(Ellipse((3.1, 1.5), 2.0, 1.7, fc=GREEN + "33", ec=GREEN))
    eye, d = np.array([0.1, 2.7]), np.array([4.6, -1.75])
    arrow(ax, eye, eye + d, RED)
    points = np.array([eye + t * d for t in np.linspace(0.3, 0.8, 7)])
    ax.scatter(*points.T, s=[8, 20, 60, 34, 14, 8, 6], color=RED, zorder=3)
    ax.text(0.1, 2.85, "o, d", color=RED)
    ax.text(1.3, 0.12, "the box [−1, 1]³", fontsize=9)
    x = points[2]
    box(ax, (6.3, 0.55), (1.5, 0.55), "$F_σ$: density")
    arrow(ax, x, (5.52, 0.6), INK, connectionstyle="arc3,rad=0.12")
    box(ax, (6.3, 2.5), (1.5, 0.55), "$F_{uv}$")
    arrow(ax, x, (5.52, 2.5), INK, connectionstyle="arc3,rad=-0.15")
    ax.add_patch(Ellipse((8.6, 2.2), 1.7, 1.7, fc=BLUE + "22", ec=BLUE))
    ax.add_patch(Ellipse((8.6, 2.2), 1.7, 0.55, fc="none", ec=BLUE, lw=0.6))
    ax.plot(8.35, 2.6, "o", color=RED)
    ax.text(8.45, 2.65, "u", color=RED)
    ax.text(8.6, 1.1, "texture: the unit sphere", ha="center", fontsize=9, color=BLUE)
    arrow(ax, (7.08, 2.5), (8.25, 2.6))
    box(ax, (11.0, 2.5), (1.9, 0.55), "$F_{tex}$(u, d): colour")
    arrow(ax, (8.5, 2.6), (10.02, 2.5))
    box(ax, (6.3, 3.5), (1.5, 0.5), "$F_{uv}^{-1}$", GOLD)
    arrow(ax, (8.3, 2.7), (7.08, 3.5), GOLD)
    arrow(ax, (5.52, 3.5), x, GOLD, connectionstyle="arc3,rad=0.2")
    ax.text(3.0, 3.45, "cycle loss", color=GOLD, fontsize=9)
    flat(ax, (0, 12.1), (-0.1, 3.9))


DRAWINGS: dict[Callable, tuple[float, float]] = {
    shell: (9, 3.4),
    filtering: (9, 3.2),
    transport: (8, 3.4),
    generator: (11, 3.0),
    silhouettes: (9, 3.0),
    capture: (10, 3.3),
}


def main() -> None:
    plt.rcParams |= {"svg.hashsalt": "mesoshell", "font.size": 11}
    for draw, size in DRAWINGS.items():
        figure = plt.figure(figsize=size, layout="constrained")
        draw(figure)
        figure.savefig(Path(__file__).with_name(f"{draw.__name__}.svg"), metadata={"Date": None}, facecolor="white")
        plt.close(figure)


if __name__ == "__main__":
    main()
