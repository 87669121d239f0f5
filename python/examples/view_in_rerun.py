"""Shows frames in Rerun: image, classes and depth in the camera that saw them, and the mesh of the scene around it.

    pip install . rerun-sdk    # in a checkout
    python view_in_rerun.py                    # opens the viewer
    python view_in_rerun.py --save moon.rrd    # writes a file, for `rerun moon.rrd`
"""

from __future__ import annotations

import argparse

import numpy as np
import regolith_render as rr
import rerun

parser = argparse.ArgumentParser(description="Shows frames in Rerun.")
parser.add_argument("--preset", default="surface_train_full")
parser.add_argument("--seed", type=int, default=7)
parser.add_argument("--frames", type=int, default=8, help="poses of the camera, half a metre apart")
parser.add_argument("--size", type=int, default=512, help="pixels a side")
parser.add_argument("--adapter", help="a part of the name of a GPU, or cpu")
parser.add_argument("--save", help="write this file instead of opening the viewer")

COLOURS = {"regolith": (170, 140, 110), "rock": (220, 45, 40), "sky": (70, 120, 205)}


def log_mesh(scene: rr.Scene) -> None:
    """The triangles that the frame draws, in the colours of their classes."""
    mesh = scene.mesh(drawn=True)
    colours = np.full((len(mesh["vertices"]), 3), 60, np.uint8)
    for name, class_id in rr.CLASSES.items():
        of_class = mesh["triangles"][mesh["triangle_class"] == class_id]
        colours[of_class.ravel()] = COLOURS[name]
    rerun.log(
        "world/mesh",
        rerun.Mesh3D(
            vertex_positions=mesh["vertices"],
            vertex_normals=mesh["normals"],
            triangle_indices=mesh["triangles"],
            vertex_colors=colours,
        ),
        static=True,
    )


def log_frame(frame: rr.Frame) -> None:
    """The camera with its images. Rerun's cameras have the axes of OpenCV, as `world_from_camera` has."""
    camera = frame.meta["camera"]
    pose = np.array(camera["world_from_camera"])
    height, width = frame["mask"].shape
    rerun.log("world/camera", rerun.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    rerun.log("world/camera/image", rerun.Pinhole(image_from_camera=camera["K"], resolution=[width, height]))
    rerun.log("world/camera/image/rgb", rerun.Image(frame["rgb"]))
    rerun.log("world/camera/image/classes", rerun.SegmentationImage(frame["mask"], opacity=0.4))
    depth = np.where(np.isfinite(frame["depth"]), frame["depth"], 0.0).astype(np.float32)  # 0 is no depth: the sky
    rerun.log("world/camera/image/depth", rerun.DepthImage(depth, meter=1.0, depth_range=(0.0, 100.0)))


def main() -> None:
    options = parser.parse_args()
    rerun.init("regolith_render", spawn=options.save is None)
    if options.save is not None:
        rerun.save(options.save)
    rerun.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    classes = [rerun.AnnotationInfo(id=rr.CLASSES[name], label=name, color=colour) for name, colour in COLOURS.items()]
    rerun.log("world", rerun.AnnotationContext(classes), static=True)
    outputs = ("rgb", "mask", "depth")
    with rr.Renderer(options.preset, size=options.size, outputs=outputs, adapter=options.adapter) as renderer:
        scene = renderer.scene(options.seed)
        log_mesh(scene)
        start = np.array(scene.render().meta["camera"]["world_from_camera"])[:3, 3]
        for step in range(options.frames):
            x, y = start[0] + 0.5 * step, start[1]
            eye = (x, y, scene.ground_height(x, y) + 1.8)
            rerun.set_time("pose", sequence=step)
            log_frame(scene.render(camera=rr.Camera(position=eye)))
    rerun.disconnect()


if __name__ == "__main__":
    main()
