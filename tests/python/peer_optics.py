"""Rays through a hyperboloid and the ellipsoid that goes with it, by optiland.

Reads a JSON file: rows of rays (origin x, y, z, direction x, y, z; mm, z upwards), the two conics with their apertures, the points
where each ray is said to meet both mirrors and the sample's plane, whether an aperture is said to stop it, and how long the lists
of rays to time are and how often to trace each. Prints one JSON object: the largest difference in a coordinate, how many are
stopped, and seconds per ray of the vectorised trace of each list, the best of the repeats.
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
stopped = i[-1] == 0
theirs = np.stack([x[1:4], y[1:4], -z[1:4]], axis=-1).swapaxes(0, 1)
ours = np.array(task["points"])
assert (stopped == np.array(task["stopped"])).all(), "apertures stop other rays"
worst = np.abs(theirs - ours)[~stopped].max()
seconds = []
for count, repeats in zip(task["timed"], task["repeats"]):
    many = np.tile(rays, (count // len(rays) + 1, 1))[:count]
    best = np.inf
    for _ in range(repeats):
        batch = launched(many)
        start = time.perf_counter()
        lens.surfaces.trace(batch)
        best = min(best, time.perf_counter() - start)
    seconds.append(best / count)
print(json.dumps({"worst_mm": worst, "stopped": int(stopped.sum()), "seconds_per_ray": seconds}))
