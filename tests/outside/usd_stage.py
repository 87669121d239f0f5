"""usd-core reads the OpenUSD stage: no diagnostics, valid, with the scene's prims, labels, camera and triangles."""

from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdSemantics, UsdShade, UsdUtils, UsdValidation

from cases import Frame, Soup
from report import Report

FIXED_PRIMS = {
    "/World": "Xform",
    "/World/Regolith": "Mesh",
    "/World/Rocks": "Xform",
    "/World/Sun": "DistantLight",
    "/World/StarDome": "Mesh",
    "/World/Stars": "Xform",
    "/World/RoverCam": "Camera",
}


def check(path: Path, frame: Frame, soup: Soup, report: Report) -> None:
    """Compares everything that usd-core reads from one file."""
    name = path.name
    diagnostics = UsdUtils.CoalescingDiagnosticDelegate()
    stage = Usd.Stage.Open(str(path))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    messages = [item.commentary for item in diagnostics.TakeUncoalescedDiagnostics()]
    prims = list(stage.Traverse())
    report.none(f"{name}: opens without diagnostics, prims", messages, len(prims))
    report.none(
        f"{name}: UsdValidation", [error.GetErrorAsString() for error in errors], f"{len(validators)} validators"
    )
    report.none(f"{name}: prims, units, up axis", _missing(stage, soup), f"{len(FIXED_PRIMS)} and rocks, stars")
    meshes = [prim for prim in prims if prim.IsA(UsdGeom.Mesh)]
    wrong = [fault for prim in meshes for fault in _wrong_labels(prim)]
    report.none(f"{name}: labels of both kinds, meshes", wrong, len(meshes))
    _check_camera(stage, name, frame, report)
    _check_sun(stage, name, frame, report)
    _check_meshes(stage, name, soup, report)


def _missing(stage: Usd.Stage, soup: Soup) -> list[str]:
    """Missing or mistyped prims, and wrong metadata of the stage."""
    kinds = {path: stage.GetPrimAtPath(path).GetTypeName() for path in FIXED_PRIMS if stage.GetPrimAtPath(path)}
    faults = [path for path, kind in FIXED_PRIMS.items() if kinds.get(path) != kind]
    found = {prim.GetName() for prim in stage.GetPrimAtPath("/World/Rocks").GetChildren()}
    wanted = {f"Rock_{instance - 1:03}" for instance in np.unique(soup.instances) if instance > 0}
    faults += sorted(found ^ wanted)
    stars = stage.GetPrimAtPath("/World/Stars").GetChildren()
    if not any(star.GetName() == "Star_000" for star in stars) or len(stars) < 150:
        faults.append(f"{len(stars)} stars")
    if stage.GetDefaultPrim().GetPath() != Sdf.Path("/World"):
        faults.append("default prim")
    if UsdGeom.GetStageUpAxis(stage) != UsdGeom.Tokens.z or UsdGeom.GetStageMetersPerUnit(stage) != 1.0:
        faults.append("axis or unit")
    return faults


def _class_of(path: str) -> str:
    """The class that a mesh must be labelled with, from its path."""
    if path == "/World/Regolith":
        return "regolith"
    return "rock" if path.startswith("/World/Rocks/") else "sky"


def _wrong_labels(prim: Usd.Prim) -> list[str]:
    """Faults of the label, as UsdSemantics and as the older Semantics attributes have it."""
    wanted = _class_of(str(prim.GetPath()))
    labels = UsdSemantics.LabelsQuery("class", Usd.TimeCode.Default()).ComputeUniqueDirectLabels(prim)
    older = "semantic:Semantics_class:params:semantic"
    kind, data = (prim.GetAttribute(older + end).Get() for end in ("Type", "Data"))
    fault = f"{prim.GetPath()} is {list(labels)}, {kind} {data}"
    return [] if [str(label) for label in labels] == [wanted] and (kind, data) == ("class", wanted) else [fault]


def _pose(stage: Usd.Stage, path: str) -> np.ndarray:
    """The transform `world_from_prim`, for column vectors."""
    return np.array(UsdGeom.XformCache().GetLocalToWorldTransform(stage.GetPrimAtPath(path))).T


def _check_camera(stage: Usd.Stage, name: str, frame: Frame, report: Report) -> None:
    """Focal lengths in pixels, pose and clipping range against the frame's record."""
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/World/RoverCam")).GetCamera()
    height, width = frame.classes.shape
    focal_px = [
        camera.focalLength / camera.horizontalAperture * width,
        camera.focalLength / camera.verticalAperture * height,
    ]
    worst_px = np.abs(np.array(focal_px) - [frame.k[0, 0], frame.k[1, 1]]).max()
    report.at_most(f"{name}: focal length, difference to the record", worst_px, 1e-3, " px")
    recorded = frame.record["camera"]
    off = np.abs(_pose(stage, "/World/RoverCam") - recorded["world_from_camera_gl"]).max()
    report.at_most(f"{name}: camera pose, difference to the record", off, 1e-6)
    clipping = [camera.clippingRange.min, camera.clippingRange.max]
    off = np.abs(np.array(clipping) - [recorded["near_m"], recorded["far_m"]]).max()
    report.at_most(f"{name}: clipping range, difference to the record", off, 1e-6, " m")


def _check_sun(stage: Usd.Stage, name: str, frame: Frame, report: Report) -> None:
    """Direction and angle of the light against the frame's record."""
    light = UsdLux.DistantLight(stage.GetPrimAtPath("/World/Sun"))
    towards = _pose(stage, "/World/Sun")[:3, 2]
    report.at_most(f"{name}: sun direction, difference to the record", np.abs(towards - frame.sun).max(), 1e-6)
    off = abs(light.GetAngleAttr().Get() - 0.53) + abs(frame.record["sun"]["angular_diameter_deg"] - 0.53)
    report.at_most(f"{name}: sun angle, difference to 0.53 deg", off, 1e-6, " deg")


def _check_meshes(stage: Usd.Stage, name: str, soup: Soup, report: Report) -> None:
    """Triangles, points and colours of ground and rocks against the arrays."""
    faults, worst_m, count = [], 0.0, 0
    for instance in np.unique(soup.instances):
        path = f"/World/Rocks/Rock_{instance - 1:03}" if instance else "/World/Regolith"
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(path))
        if not mesh:
            faults.append(f"no {path}")
            continue
        vertices, triangles = soup.part(instance)
        pose = _pose(stage, path)
        points = np.array(mesh.GetPointsAttr().Get()) @ pose[:3, :3].T + pose[:3, 3]
        corners = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        count += len(corners)
        if points.shape != vertices.shape or not np.array_equal(corners, triangles):
            faults.append(f"{path} has different triangles")
            continue
        worst_m = max(worst_m, np.abs(points - vertices).max())
        material = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()[0]
        colour = material.ComputeSurfaceSource()[0].GetInput("diffuseColor").Get()
        if not np.allclose(colour, soup.arrays["albedo"][instance], rtol=1e-6):
            faults.append(f"{path} has a different colour")
    if count != len(soup.triangles):
        faults.append(f"{count} triangles instead of {len(soup.triangles)}")
    report.none(f"{name}: triangles and colours as in .npz", faults, count)
    report.at_most(f"{name}: points, distance to those of .npz", worst_m, 1e-4, " m")
