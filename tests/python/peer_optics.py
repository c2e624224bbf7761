"""Rays through a hyperboloid and the ellipsoid that goes with it, by optiland.

Reads a JSON file: rows of rays (origin x, y, z, direction x, y, z; mm, z upwards), the two conics, their apertures and how many
rays to time. Prints one JSON object: where each ray meets both mirrors and the sample's plane (null where an aperture stops it), and
seconds per ray of the vectorised trace, the best of five.
"""

import json
import sys
import time

import numpy as np
from optiland.optic import Optic
from optiland.rays import RealRays

task = json.load(open(sys.argv[1]))
rays = np.array(task["rays"])


def system():
    # optiland's z axis points down here: both mirrors then open along it.
    lens = Optic()
    lens.surfaces.add(index=0, z=-task["centre_height"])
    for index, name in enumerate(["convex", "dome"], start=1):
        conic = task[name]
        lens.surfaces.add(
            index=index,
            z=-conic["vertex_height"],
            radius=conic["radius"],
            conic=conic["constant"],
            material="mirror",
            is_stop=index == 1,
            aperture=2 * conic["aperture"],
        )
    lens.surfaces.add(index=3, z=0.0)
    lens.wavelengths.add(value=0.55, is_primary=True)
    return lens


def launched(rows):
    x, y, z, dx, dy, dz = rows.T
    return RealRays(x, y, -z, dx, dy, -dz, np.ones(len(x)), np.full(len(x), 0.55))


lens = system()
lens.surfaces.trace(launched(rays))
x, y, z, i = (np.array(v) for v in (lens.surfaces.x, lens.surfaces.y, lens.surfaces.z, lens.surfaces.intensity))
points = [
    None if i[-1][k] == 0 or not np.isfinite(x[-1][k]) else [[x[s][k], y[s][k], -z[s][k]] for s in (1, 2, 3)]
    for k in range(len(rays))
]
many = np.tile(rays, (task["timed"] // len(rays) + 1, 1))[: task["timed"]]
best = np.inf
for _ in range(5):
    batch = launched(many)
    start = time.perf_counter()
    lens.surfaces.trace(batch)
    best = min(best, time.perf_counter() - start)
print(json.dumps({"points": points, "seconds_per_ray": best / len(many)}))
