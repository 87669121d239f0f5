"""Runs inside Blender's Python module: imports a stage and renders it in Cycles through the pixel centres.

    blender_worker.py STAGE OUT.npz WIDTH HEIGHT SUN_ANGLE_DEG planes
    blender_worker.py STAGE OUT.npz WIDTH HEIGHT SUN_ANGLE_DEG beauty SAMPLES RED GREEN BLUE

`planes` writes arrays H x W: `instance` (0 ground, rock number + 1, SKY for dome and stars, NOTHING where no ray
hits), `position` (metres, world), `normal`, `facet_normal`, and `sunlight`, the irradiance under a sun of irradiance 1.
`beauty` writes `radiance`, path-traced under a sun of the given irradiance.
"""

import math
import os
import sys
import tempfile
import warnings
from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

# Blender's largest pass index is 32767.
SKY, NOTHING = 30000, 30001
SUN_SAMPLES = 64
BOUNCES = 8


def open_stage(path: str, width: int, height: int, sun_angle_deg: float) -> bpy.types.Light:
    """Imports the stage into an empty scene, corrects the sun's angle and unit, and returns the sun.

    Blender takes the stage's angle, a diameter, for a radius and doubles it; it reads the intensity as radiance of
    the disc.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=path)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.use_denoising = False
    scene.cycles.use_adaptive_sampling = False
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.camera = bpy.data.objects["RoverCam"]
    for item in bpy.data.objects:
        if item.type == "MESH":
            item.pass_index = instance_of(item.name)
            # The stage says so with primvars:doNotCastShadows, which Blender does not read.
            item.visible_shadow = item.pass_index < SKY
    sun = bpy.data.objects["Sun"].data
    sun.angle = math.radians(sun_angle_deg)
    sun.normalize = True
    return sun


def instance_of(name: str) -> int:
    """Instance id of a mesh, from its name."""
    if name == "Regolith":
        return 0
    return int(name.removeprefix("Rock_")) + 1 if name.startswith("Rock_") else SKY


def render() -> np.ndarray:
    """Renders; linear RGB, H x W x 3, top row first."""
    scene = bpy.context.scene
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = os.path.join(folder, "image.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        width, height = image.size
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1, :, :3].copy()


def material(shader: Callable[..., bpy.types.NodeSocket], *words: Any) -> bpy.types.Material:
    """A material whose surface shader is what `shader(tree, *words)` builds."""
    result = bpy.data.materials.new("override")
    result.use_nodes = True
    tree = result.node_tree
    tree.nodes.clear()
    tree.links.new(shader(tree, *words), tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return result


def emission(tree: bpy.types.NodeTree, node: str, output: str) -> bpy.types.NodeSocket:
    """An emitter whose colour is an output of a node."""
    emitter = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(tree.nodes.new(node).outputs[output], emitter.inputs["Color"])
    return emitter.outputs["Emission"]


def unlit(tree: bpy.types.NodeTree, colour: tuple[float, ...]) -> bpy.types.NodeSocket:
    """An emitter of constant radiance."""
    emitter = tree.nodes.new("ShaderNodeEmission")
    emitter.inputs["Color"].default_value = colour
    return emitter.outputs["Emission"]


def diffuse(tree: bpy.types.NodeTree, colour: tuple[float, ...], roughness: float) -> bpy.types.NodeSocket:
    """A diffuse lobe: Lambertian at roughness 0, otherwise Oren and Nayar's."""
    lobe = tree.nodes.new("ShaderNodeBsdfDiffuse")
    lobe.inputs["Color"].default_value = colour
    lobe.inputs["Roughness"].default_value = roughness
    return lobe.outputs["BSDF"]


def planes(sun: bpy.types.Light) -> dict[str, np.ndarray]:
    """Renders everything that a frame's annotations can be compared with."""
    scene, layer = bpy.context.scene, bpy.context.view_layer
    # A Gaussian a hundredth of a pixel wide: every ray goes through the pixel centre. (A box would be a pixel wide.)
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "GAUSSIAN", 0.01
    scene.cycles.max_bounces = 0
    # Emission is 0 where no ray hits, so ids start at 1 here.
    for item in bpy.data.objects:
        item.pass_index += 1
    outputs = {
        "instance": ("ShaderNodeObjectInfo", "Object Index"),
        "position": ("ShaderNodeNewGeometry", "Position"),
        "normal": ("ShaderNodeNewGeometry", "Normal"),
        "facet_normal": ("ShaderNodeNewGeometry", "True Normal"),
    }
    scene.cycles.samples = 1
    result = {}
    for name, (node, output) in outputs.items():
        layer.material_override = material(emission, node, output)
        result[name] = render()
    ids = np.rint(result["instance"][..., 0]).astype(int)
    result["instance"] = np.where(ids > 0, ids - 1, NOTHING)
    sun.energy, sun.color = 1.0, (1.0, 1.0, 1.0)
    layer.material_override = material(diffuse, (1.0, 1.0, 1.0, 1.0), 0.0)
    scene.cycles.samples = SUN_SAMPLES
    result["sunlight"] = math.pi * render()[..., 0]
    return result


def beauty(sun: bpy.types.Light, samples: int, irradiance: list[float]) -> dict[str, np.ndarray]:
    """Path-traces the stage. Surfaces have the lobe that the renderer documents, with half the material's roughness."""
    scene = bpy.context.scene
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.max_bounces = scene.cycles.diffuse_bounces = BOUNCES
    scene.cycles.samples = samples
    sun.energy, sun.color = max(irradiance), [channel / max(irradiance) for channel in irradiance]
    for item in bpy.data.objects:
        if item.type == "MESH":
            principled = item.data.materials[0].node_tree.nodes["Principled BSDF"].inputs
            # Dome and stars only emit. As imported, they would also reflect the sun at grazing angles.
            name = "Base Color" if item.pass_index < SKY else "Emission Color"
            colour, roughness = tuple(principled[name].default_value), principled["Roughness"].default_value
            if item.pass_index < SKY:
                item.data.materials[0] = material(diffuse, colour, 0.5 * roughness)
            else:
                item.data.materials[0] = material(unlit, colour)
    return {"radiance": render()}


def main() -> None:
    """Runs what the command line asks for."""
    warnings.simplefilter("ignore", DeprecationWarning)
    path, out, width, height, angle_deg, kind, *numbers = sys.argv[1:]
    sun = open_stage(path, int(width), int(height), float(angle_deg))
    if kind == "planes":
        arrays = planes(sun)
    else:
        arrays = beauty(sun, int(numbers[0]), [float(number) for number in numbers[1:]])
    np.savez(out, **arrays)


if __name__ == "__main__":
    main()
