"""A sphere with an exported .bsdf file drawn by Mitsuba 3 (scalar_rgb): `peer_render.py cases.json`, from tests/peers_bsdf.rs.

Orthographic, seen along -z, +x to the right and +y up; black where there is no sphere.
"""
import json
import sys

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
# Per pixel: under one light only the position within the pixel is drawn.
SAMPLES = {"one light": 256, "furnace": 1024}


def draw(case, side):
    if "light" in case:
        emitter = {"type": "directional", "direction": [-x for x in case["light"]], "irradiance": case["irradiance"]}
    else:
        emitter = {"type": "constant", "radiance": case["radiance"]}
    scene = mi.load_dict(
        {
            "type": "scene",
            # Direct light alone: a sphere does not light itself.
            "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
            "sensor": {
                "type": "orthographic",
                "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 3], target=[0, 0, 0], up=[0, 1, 0]),
                "film": {
                    "type": "hdrfilm",
                    "width": side,
                    "height": side,
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgb",
                    "component_format": "float32",
                },
                "sampler": {"type": "independent", "sample_count": SAMPLES["one light" if "light" in case else "furnace"]},
            },
            "sphere": {"type": "sphere", "bsdf": {"type": "measured", "filename": case["file"]}},
            "emitter": emitter,
        }
    )
    return np.array(mi.render(scene, seed=1))[:, :, :3]


def main():
    given = json.load(open(sys.argv[1]))
    side, failed = given["side"], []
    for case in given["cases"]:
        ours = np.array(case["pixels"]).reshape(side, side, 3)
        theirs = draw(case, side)
        difference = np.abs(theirs - ours).mean() / theirs.mean()
        print(f"{case['name']:28} mean relative difference {difference:.2%}, means {ours.mean():.4f} {theirs.mean():.4f}")
        if not difference <= given["tolerance"]:
            failed.append(case["name"])
    if failed:
        sys.exit("above tolerance: " + ", ".join(failed))


main()
