"""Projects exported vertices onto the frame's pixels, and lifts the frame's depth onto the exported surface.

The first is arithmetic with K and the pose, as in docs/outputs.md; the second casts rays with Embree.
"""

import numpy as np
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from cases import REGOLITH, ROCK, SKY, Frame, Soup
from report import Report

NEIGHBOURS = [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
# A vertex whose depth is this close, relative, to the interpolated depth is visible.
SAME_DEPTH = 5e-4
# A vertex nearer, by this fraction, than all nine pixels around it is in front of what they show.
IN_FRONT = 1e-4


def iou(ours: np.ndarray, theirs: np.ndarray, label: int) -> float:
    """Intersection over union of a label in two masks; 1 where neither has it."""
    union = ((ours == label) | (theirs == label)).sum()
    return ((ours == label) & (theirs == label)).sum() / union if union else 1.0


def check(frame: Frame, soup: Soup, report: Report) -> None:
    """Checks both directions, from the arrays to the pixels and back."""
    _check_camera(frame, soup, report)
    _check_vertices(frame, soup, report)
    _check_depth(frame, soup, report)


def _check_camera(frame: Frame, soup: Soup, report: Report) -> None:
    """Compares the camera in the arrays with that of the record."""
    pairs = [("K", frame.k), ("world_from_camera", frame.pose), ("sun_direction", frame.sun)]
    worst = max(np.abs(soup.arrays[name] - recorded).max() for name, recorded in pairs)
    report.at_most("npz: K, pose, sun, difference to the record", worst, 1e-9)


def _between_pixels(depth_m: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Depth at continuous pixel coordinates, bilinear in 1/z between pixel centres."""
    x, y = np.floor(u - 0.5).astype(int), np.floor(v - 0.5).astype(int)
    s, t = u - 0.5 - x, v - 0.5 - y
    inverse = 1.0 / depth_m
    top = (1 - s) * inverse[y, x] + s * inverse[y, x + 1]
    bottom = (1 - s) * inverse[y + 1, x] + s * inverse[y + 1, x + 1]
    return 1.0 / np.maximum((1 - t) * top + t * bottom, 1e-9)


def _check_vertices(frame: Frame, soup: Soup, report: Report) -> None:
    """Counts, of the vertices that are visible by the depth plane, those with their own label within a pixel."""
    owner = np.zeros(len(soup.vertices), int)
    owner[soup.triangles.ravel()] = np.repeat(soup.instances, 3)
    local = (soup.vertices - frame.pose[:3, 3]) @ frame.pose[:3, :3]
    ahead = local[:, 2] > frame.record["camera"]["near_m"]
    owner, local = owner[ahead], local[ahead]
    projected = local @ frame.k.T
    u, v = projected[:, 0] / projected[:, 2], projected[:, 1] / projected[:, 2]
    height, width = frame.depth_m.shape
    inside = (u >= 1) & (u < width - 1) & (v >= 1) & (v < height - 1)
    u, v, z, owner = u[inside], v[inside], local[inside, 2], owner[inside]
    x, y = u.astype(int), v.astype(int)

    def around(plane: np.ndarray) -> np.ndarray:
        return np.stack([plane[y + dy, x + dx] for dx, dy in NEIGHBOURS])

    visible = np.abs(z / _between_pixels(frame.depth_m, u, v) - 1) < SAME_DEPTH
    visible |= z < around(frame.depth_m).min(0) * (1 - IN_FRONT)
    classes = np.where(owner > 0, ROCK, REGOLITH)
    own = ((around(frame.instances) == owner) & (around(frame.classes) == classes)).any(0)
    report.at_least("visible vertices in the image", visible.sum(), 1000)
    # A tip thinner than a pixel may lie between pixel centres.
    report.at_least("visible vertices with their own label within 1 px", 100 * own[visible].mean(), 99.8, " %")


def _check_depth(frame: Frame, soup: Soup, report: Report) -> None:
    """Compares labels and depth of every pixel with the first triangle hit by the ray through its centre."""
    height, width = frame.depth_m.shape
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3)
    rays = pixels @ np.linalg.inv(frame.k).T @ frame.pose[:3, :3].T
    eye = frame.pose[:3, 3]
    mesh = trimesh.Trimesh(soup.vertices, soup.triangles, process=False)
    directions = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    hit = RayMeshIntersector(mesh).intersects_first(np.broadcast_to(eye, rays.shape), directions)
    instances = np.where(hit < 0, 0, soup.instances[hit])
    classes = np.where(hit < 0, SKY, np.where(instances > 0, ROCK, REGOLITH))
    ours, our_instances, depth_m = frame.classes.ravel(), frame.instances.ravel(), frame.depth_m.ravel()
    lowest = min(iou(ours, classes, label) for label in (REGOLITH, ROCK, SKY))
    report.at_least("Embree: lowest IoU of a class", lowest, 0.999)
    rocks = ours == ROCK
    right = (our_instances == instances)[rocks].mean()
    report.at_least("Embree: rock pixels with the same rock", 100 * right, 99.9, " %")

    same = (ours != SKY) & (ours == classes) & (our_instances == instances)
    corners = soup.vertices[soup.triangles[hit[same]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = eye + depth_m[same, None] * rays[same]
    error_m = np.abs(((points - corners[:, 0]) * normals).sum(1))
    report.at_most("depth, distance to the surface, 99 %", np.quantile(error_m, 0.99), 1e-3, " m")
    true_m = ((corners[:, 0] - eye) * normals).sum(1) / (rays[same] * normals).sum(1)
    error = np.abs(depth_m[same] / true_m - 1)
    report.at_most("depth along the axis, relative error, 99 %", np.quantile(error, 0.99), 1e-4)
