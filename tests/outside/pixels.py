"""Exported vertices on the frame's pixels, and the frame's depth on the exported surface.

The first is plain arithmetic with K and the pose, as the README has it; the second casts Embree's rays.
"""

import numpy as np
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from cases import REGOLITH, ROCK, SKY, Frame, Soup
from report import Report

NEIGHBOURS = [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
# A vertex this close to the depth between the pixels, relative to it, is on the surface that is seen.
SAME_DEPTH = 5e-4
# A vertex nearer than all nine pixels around it by this, relative, is before whatever they show.
IN_FRONT = 1e-4


def iou(ours: np.ndarray, theirs: np.ndarray, label: int) -> float:
    """Intersection over union of a label in two masks; 1 where neither has it."""
    union = ((ours == label) | (theirs == label)).sum()
    return ((ours == label) & (theirs == label)).sum() / union if union else 1.0


def check(frame: Frame, soup: Soup, report: Report) -> None:
    """Both ways, from the arrays to the pixels and back."""
    _check_camera(frame, soup, report)
    _check_vertices(frame, soup, report)
    _check_depth(frame, soup, report)


def _check_camera(frame: Frame, soup: Soup, report: Report) -> None:
    """The arrays carry the camera of the record."""
    pairs = [("K", frame.k), ("world_from_camera", frame.pose), ("sun_direction", frame.sun)]
    worst = max(np.abs(soup.arrays[name] - recorded).max() for name, recorded in pairs)
    report.at_most("npz: K, pose, sun off the record", worst, 1e-9)


def _between_pixels(depth_m: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Depth at places of the picture (pixels), bilinear in 1/z between the centres of the pixels."""
    x, y = np.floor(u - 0.5).astype(int), np.floor(v - 0.5).astype(int)
    s, t = u - 0.5 - x, v - 0.5 - y
    inverse = 1.0 / depth_m
    top = (1 - s) * inverse[y, x] + s * inverse[y, x + 1]
    bottom = (1 - s) * inverse[y + 1, x] + s * inverse[y + 1, x + 1]
    return 1.0 / np.maximum((1 - t) * top + t * bottom, 1e-9)


def _check_vertices(frame: Frame, soup: Soup, report: Report) -> None:
    """Of the vertices that the depth buffer says are seen, those with their own label within a pixel."""
    owner = np.zeros(len(soup.vertices), int)
    owner[soup.triangles.ravel()] = np.repeat(soup.instances, 3)
    local = (soup.vertices - frame.pose[:3, 3]) @ frame.pose[:3, :3]
    ahead = local[:, 2] > frame.record["camera"]["near_m"]
    owner, local = owner[ahead], local[ahead]
    on_film = local @ frame.k.T
    u, v = on_film[:, 0] / on_film[:, 2], on_film[:, 1] / on_film[:, 2]
    height, width = frame.depth_m.shape
    inside = (u >= 1) & (u < width - 1) & (v >= 1) & (v < height - 1)
    u, v, z, owner = u[inside], v[inside], local[inside, 2], owner[inside]
    x, y = u.astype(int), v.astype(int)

    def around(plane: np.ndarray) -> np.ndarray:
        return np.stack([plane[y + dy, x + dx] for dx, dy in NEIGHBOURS])

    seen = np.abs(z / _between_pixels(frame.depth_m, u, v) - 1) < SAME_DEPTH
    seen |= z < around(frame.depth_m).min(0) * (1 - IN_FRONT)
    classes = np.where(owner > 0, ROCK, REGOLITH)
    own = ((around(frame.instances) == owner) & (around(frame.classes) == classes)).any(0)
    report.at_least("vertices on the picture that are seen", seen.sum(), 1000)
    # A tip thinner than a pixel may lie between the centres.
    report.at_least("seen vertices with their own label within 1 px", 100 * own[seen].mean(), 99.8, " %")


def _check_depth(frame: Frame, soup: Soup, report: Report) -> None:
    """Labels and depth of every pixel against the first triangle on the ray through its centre."""
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
    off_m = np.abs(((points - corners[:, 0]) * normals).sum(1))
    report.at_most("depth off the surface, 99 %", np.quantile(off_m, 0.99), 1e-3, " m")
    true_m = ((corners[:, 0] - eye) * normals).sum(1) / (rays[same] * normals).sum(1)
    off = np.abs(depth_m[same] / true_m - 1)
    report.at_most("depth off along the axis, 99 %", np.quantile(off, 0.99), 1e-4)
