"""Slepian eigenvalues against 50 digits: `peer_slepian.py cases.json`, from tests/peers_slepian.rs.

Eigenvalues of the Gram matrix of each m over the zone, for all harmonics or those with l + m odd, whose norm over the
hemisphere is twice that of the Gram matrix.
"""
import json
import sys

import mpmath as mp

from exact import SPHERE, Zone, gauss_legendre


def gram(zone, m, top):
    """As exact.gram for the degrees m..top, each function evaluated once per node; degrees up to L are its corner."""
    half, middle = (zone.a - zone.b) / 2, (zone.a + zone.b) / 2
    rule = [(2 * mp.pi * half * w, middle + half * x) for x, w in gauss_legendre(top + 1)]
    rows = [[SPHERE.polar(l, m, mu) for _, mu in rule] for l in range(m, top + 1)]
    weighted = [[w * p for (w, _), p in zip(rule, row)] for row in rows]
    return [[mp.fdot(row, other) for other in rows] for row in weighted]


def main():
    cases = json.load(open(sys.argv[1]))
    failed = []
    kept = {}
    for case in cases:
        zone = Zone(case["a"], case["b"])
        absolute = relative = 0.0
        for block in case["blocks"]:
            m, degrees = block["m"], block["degrees"]
            key = (case["a"], case["b"], m)
            if key not in kept:
                kept[key] = gram(zone, m, case["top"])
            matrix = mp.matrix([[kept[key][k - m][l - m] for l in degrees] for k in degrees])
            want = sorted(mp.eigsy(matrix, eigvals_only=True), reverse=True)
            for got, want in zip(block["eigenvalues"], want, strict=True):
                error = float(abs(got - want * case["scale"]))
                # NaN counts as the worst.
                absolute = error if not error <= absolute else absolute
                if want > case["above"]:
                    relative = max(relative, error / float(want * case["scale"]))
        print(f"{case['name']}: {absolute:.1e} of {case['tolerance']:.0e}; relative, above {case['above']:.0e}: {relative:.1e}")
        if not absolute <= case["tolerance"]:
            failed.append(case["name"])
    if failed:
        sys.exit("above tolerance: " + ", ".join(failed))


main()
