"""Exported .bsdf files in Mitsuba 3 (variant scalar_rgb): `peer_bsdf.py cases.json`, from tests/peers_bsdf.rs.

Mitsuba's si.wi is the camera and the argument of eval the light; the value holds the light's cosine.
"""
import json
import os
import sys

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
# Of an albedo from 4,000 samples, whose standard error is up to 0.8%.
SAMPLES = 0.03


def evaluator(file):
    bsdf = mi.load_dict({"type": "measured", "filename": file})
    context, si = mi.BSDFContext(), mi.SurfaceInteraction3f()

    def f_cos(light, camera):
        si.wi = mi.Vector3f(camera)
        return np.array(bsdf.eval(context, si, mi.Vector3f(light)), dtype=float)

    def samples(camera, rng, count):
        """Mean weight of Mitsuba's own samples: the albedo, if `luminance` and `vndf` are what they should be."""
        si.wi = mi.Vector3f(camera)
        weights = [np.array(bsdf.sample(context, si, 0.5, mi.Point2f(rng.random(2)))[1]) for _ in range(count)]
        return np.mean(weights, axis=0)

    return f_cos, samples


def errors(f_cos, pairs):
    """Median, 95% quantile and maximum of the relative errors, and the largest difference to our reader."""
    errors, readers = [], 0.0
    for light, camera, want, ours in pairs:
        got = f_cos(light, camera)
        errors.append(np.abs(got / np.array(want) - 1).max())
        readers = max(readers, (np.abs(got - ours) / np.maximum(np.abs(got), 0.01)).max())
    return np.quantile(errors, [0.5, 0.95, 1.0]), readers


def main():
    failed = []
    rng = np.random.default_rng(1)
    for case in json.load(open(sys.argv[1])):
        f_cos, samples = evaluator(case["file"])
        (median, p95, worst), readers = errors(f_cos, case["pairs"])
        (lobe_median, lobe_p95, lobe_worst), lobe_readers = errors(f_cos, case["lobe_pairs"])
        readers = max(readers, lobe_readers)
        albedos = []
        for row in case["albedos"]:
            sums = np.zeros((2, 3))
            for light, weight, want in row["nodes"]:
                sums += weight * np.array([f_cos(light, row["wo"]), want])
            albedo = (sums[0] / sums[1] - 1)[np.abs(sums[0] / sums[1] - 1).argmax()]
            mean = samples(row["wo"], rng, 4000)
            albedos.append((albedo, np.abs(mean / sums[0] - 1).max()))
        size = os.path.getsize(case["file"])
        said = [
            f"{case['name']:14} {size:9} B",
            f"median {median:.3%}  p95 {p95:.3%}  max {worst:.1%}",
            f"near the lobe {lobe_median:.3%}  {lobe_p95:.3%}  {lobe_worst:.1%}",
            f"readers differ by {readers:.1e}",
            "albedo " + " ".join(f"{a:+.3%} (samples {s:.2%})" for a, s in albedos),
        ]
        print("  ".join(said))
        within = median <= case["median"] and p95 <= case["p95"] and readers <= case["readers"]
        within = within and lobe_median <= case["median"] and lobe_p95 <= case["lobe_p95"]
        if not (within and all(abs(a) <= case["albedo"] and s <= SAMPLES for a, s in albedos)):
            failed.append(case["name"])
    if failed:
        sys.exit("above tolerance: " + ", ".join(failed))


main()
