"""Solids and sections as trimesh and ezdxf read them: `peer_handover.py cases.json`, written by tests/peers_handover.rs."""
import json
import sys

import ezdxf
import numpy as np
import trimesh


def to_polyline(points, corners):
    """Greatest distance of points from an open polyline."""
    a, b = corners[:-1], corners[1:]
    along = b - a
    worst = 0.0
    for p in points:
        t = np.clip(((p - a) * along).sum(1) / (along**2).sum(1), 0.0, 1.0)
        worst = max(worst, np.hypot(*(a + t[:, None] * along - p).T).min())
    return worst


def solid(case):
    mesh = trimesh.load(case["stl"])
    error = abs(mesh.volume - case["volume_mm3"])
    print(
        f"{case['name']}: {len(mesh.faces)} faces, watertight {mesh.is_watertight}, winding {mesh.is_winding_consistent}, "
        f"volume {mesh.volume:.1f} mm3, {error / case['volume_mm3']:.1e} off"
    )
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.is_volume
    assert mesh.body_count == 1
    assert error <= case["volume_tolerance_mm3"], error


def section(case):
    drawing = ezdxf.readfile(case["dxf"])
    audit = drawing.audit()
    faults = [f"{fault.code}: {fault.message}" for fault in audit.errors + audit.fixes]
    assert not faults, faults
    assert drawing.units == ezdxf.units.MM
    space = drawing.modelspace()
    (outline,) = space.query("LWPOLYLINE[layer=='SECTION']")
    (mirror,) = space.query("LWPOLYLINE[layer=='MIRROR']")
    (axis,) = space.query("LINE[layer=='AXIS']")
    assert len(space) == 3 and outline.closed and not mirror.closed
    assert axis.dxf.start.x == 0.0 and axis.dxf.end.x == 0.0
    outline, mirror = (np.array(p.get_points("xy")) for p in (outline, mirror))
    tolerance = case["tolerance_mm"]
    curve = np.array(case["curve_mm"])
    radius = abs(outline[:, 0].max() - case["greatest_radius_mm"])
    off, shared = to_polyline(curve, mirror), to_polyline(mirror, np.vstack([outline, outline[:1]]))
    ends = max(np.hypot(*(mirror[0] - curve[0])), np.hypot(*(mirror[-1] - curve[-1])))
    print(f"{case['name']}: {len(outline)} points, curve {off:.1e} mm off, greatest radius {radius:.1e} mm off")
    assert (outline[:, 0] == 0.0).sum() == case["on_axis"]
    assert off < tolerance and radius < tolerance and shared < 1e-8 and ends < 1e-6, (off, radius, shared, ends)


def main():
    for case in json.load(open(sys.argv[1])):
        solid(case)
        section(case)


main()
