"""A mesh with its texture as GLB, or as OBJ with MTL and _texture.png beside it (trimesh, Pillow)."""

import io
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from mesoshell.io.atomic import replace_file
from mesoshell.io.image import linear_to_srgb, write_png


def write_textured_mesh(
    path: Path,
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "T 3"],
    uv: Float[np.ndarray, "V 2"],
    normals: Float[np.ndarray, "V 3"],
    image: Float[np.ndarray, "h w 3"],
    roughness: Float[np.ndarray, "h w"] | None = None,
) -> None:
    """uv: (0, 0) at the image's lower left corner; image: linear; roughness: of a GLB only, 1 if not given. Raises
    InputError if a file cannot be written."""
    if path.suffix.lower() == ".obj":
        picture = path.with_name(f"{path.stem}_texture.png")
        write_png(picture, image)
        replace_file(path.with_suffix(".mtl"), f"newmtl texture\nmap_Kd {picture.name}\n".encode())
        corners = faces + 1
        lines = [f"mtllib {path.with_suffix('.mtl').name}", "usemtl texture"]
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
        lines += [f"vt {u:.9g} {v:.9g}" for u, v in uv]
        lines += [f"vn {x:.6g} {y:.6g} {z:.6g}" for x, y, z in normals]
        lines += [f"f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}" for a, b, c in corners]
        replace_file(path, ("\n".join(lines) + "\n").encode())
        return
    import trimesh
    from PIL import Image

    def coded(x: np.ndarray) -> Image.Image:
        return Image.fromarray((np.clip(x, 0, 1) * 255 + 0.5).astype(np.uint8))

    rough = None
    if roughness is not None:  # glTF's channels: occlusion, roughness, metalness
        rough = coded(np.stack([np.ones_like(roughness), roughness, np.zeros_like(roughness)], axis=-1))
    material = trimesh.visual.material.PBRMaterial(  # type: ignore[attr-defined]
        baseColorTexture=coded(linear_to_srgb(np.clip(image, 0, 1))),
        metallicRoughnessTexture=rough,
        metallicFactor=0.0,
        roughnessFactor=1.0,
    )
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)  # type: ignore[attr-defined]
    stream = io.BytesIO()
    trimesh.Trimesh(vertices, faces, vertex_normals=normals, visual=visual, process=False).export(
        stream, file_type="glb"
    )
    replace_file(path, stream.getvalue())
