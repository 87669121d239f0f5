"""trimesh reads the binary glTF: one node a rock, with its labels and the vertices of the .npz export."""

from pathlib import Path

import numpy as np
import trimesh

from cases import ROCK, SKY, Frame, Soup
from report import Report


def check(path: Path, frame: Frame, soup: Soup, report: Report) -> None:
    """Compares everything that trimesh reads from one file."""
    scene = trimesh.load_scene(path, process=False)
    z_up = np.linalg.inv(scene.graph.get("World")[0])
    extras = {child: edge.get("metadata", {}) for (_, child), edge in scene.graph.transforms.edge_data.items()}
    instances = [int(instance) for instance in np.unique(soup.instances)]
    names = {instance: f"Rock_{instance - 1:03}" if instance else "Regolith" for instance in instances}
    sky_nodes = {name for name in scene.graph.nodes_geometry if name == "StarDome" or name.startswith("Star_")}
    faults = sorted((set(scene.graph.nodes_geometry) - sky_nodes) ^ set(names.values()))
    faults += [f"{name} has extras {extras[name]}" for name in sky_nodes if extras[name].get("class_id") != SKY]
    if "StarDome" not in sky_nodes or len(sky_nodes) < 100:
        faults.append(f"{len(sky_nodes)} nodes of the sky")
    worst_m, count = 0.0, 0
    for instance, name in names.items():
        if name in faults:
            continue
        of_class = {"class": "rock", "class_id": ROCK} if instance else {"class": "regolith", "class_id": 0}
        wanted = {**of_class, "instance_id": instance}
        if {key: extras[name].get(key) for key in wanted} != wanted:
            faults.append(f"{name} has extras {extras[name]}")
        pose, geometry = scene.graph.get(name)
        mesh = scene.geometry[geometry]
        vertices, triangles = soup.part(instance)
        count += len(mesh.faces)
        if mesh.vertices.shape != vertices.shape or not np.array_equal(mesh.faces, triangles):
            faults.append(f"{name} has different triangles")
            continue
        points = trimesh.transform_points(mesh.vertices, z_up @ pose)
        worst_m = max(worst_m, np.abs(points - vertices).max())
    report.none(f"{path.name}: nodes, extras, triangles as in .npz", faults, count)
    report.at_most(f"{path.name}: vertices, distance to those of .npz", worst_m, 1e-4, " m")
    # trimesh attaches cameras to the root, so this is the pose below `World`.
    camera = scene.graph.get("RoverCam")[0]
    off = np.abs(camera - frame.record["camera"]["world_from_camera_gl"]).max()
    report.at_most(f"{path.name}: camera pose, difference to the record", off, 1e-5)
    # The horizontal field of view is trimesh's own estimate.
    down_deg = np.degrees(2 * np.arctan(frame.classes.shape[0] / 2 / frame.k[1, 1]))
    report.at_most(f"{path.name}: field of view, difference to the record", abs(scene.camera.fov[1] - down_deg), 1e-4, " deg")
    sun = (z_up @ scene.graph.get("Sun")[0])[:3, 2]
    report.at_most(f"{path.name}: sun direction, difference to the record", np.abs(sun - frame.sun).max(), 1e-6)
