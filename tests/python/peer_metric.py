"""The error metric in NumPy: `peer_metric.py cases.json`, written by tests/peers_metric.rs.

Works in angles throughout: directions are (theta, phi), models are written with cosines and tangents of angles, nodes are
placed by spherical trigonometry about the mirror direction.
"""
import json
import sys

import numpy as np

THETA_O = [5, 20, 35, 50, 65, 78]
ALBEDO_AT = [10, 45, 70]
FLOOR = 1e-3


class Pair:
    """Angles between light, camera, normal and half vector."""

    def __init__(self, light, camera):
        (ti, pi), (to, po) = light, camera
        self.ti, self.to = ti, to
        cos_io = np.cos(ti) * np.cos(to) + np.sin(ti) * np.sin(to) * np.cos(pi - po)
        self.cos_d = np.sqrt((1 + cos_io) / 2)
        # Half vector = (light + camera) / (2 cos_d), component by component.
        self.hx = (np.sin(ti) * np.cos(pi) + np.sin(to) * np.cos(po)) / (2 * self.cos_d)
        self.hy = (np.sin(ti) * np.sin(pi) + np.sin(to) * np.sin(po)) / (2 * self.cos_d)
        self.hz = (np.cos(ti) + np.cos(to)) / (2 * self.cos_d)
        self.phi_i, self.phi_o = pi, po


def ggx(p, kd, lobes):
    f = np.full_like(p.hz, 1 / np.pi)[None] * np.array(kd)[:, None]
    for lobe in lobes:
        ax, ay = lobe["alpha"]
        slope2 = ((p.hx / ax) ** 2 + (p.hy / ay) ** 2) / p.hz**2
        density = 1 / (np.pi * ax * ay * p.hz**4 * (1 + slope2) ** 2)

        def smith(theta, phi):
            tangent2 = np.tan(theta) ** 2 * ((ax * np.cos(phi)) ** 2 + (ay * np.sin(phi)) ** 2)
            return (np.sqrt(1 + tangent2) - 1) / 2

        masking = 1 / (1 + smith(p.ti, p.phi_i) + smith(p.to, p.phi_o))
        shape = density * masking / (4 * np.cos(p.ti) * np.cos(p.to))
        grazing = (1 - p.cos_d) ** 5
        f0, f90 = (np.array(lobe[key])[:, None] for key in ("f0", "f90"))
        f = f + shape * (f0 * (1 - grazing) + f90 * grazing)
    return f


def lambert(p, albedo):
    return ggx(p, albedo, [])


def abc(p, kd, a, b, c, ior):
    ci, co = np.cos(p.ti), np.cos(p.to)
    # Fresnel by Snell's angle.
    sin_d = np.sqrt(1 - p.cos_d**2)
    cos_t = np.sqrt(1 - (sin_d / ior) ** 2)
    parallel = (ior * p.cos_d - cos_t) / (ior * p.cos_d + cos_t)
    perpendicular = (p.cos_d - ior * cos_t) / (p.cos_d + ior * cos_t)
    fresnel = (parallel**2 + perpendicular**2) / 2
    grooves = np.minimum(1, np.minimum(2 * p.hz * ci / p.cos_d, 2 * p.hz * co / p.cos_d))
    lobe = fresnel * grooves / (1 + b * (1 - p.hz)) ** c / (np.pi * ci * co)
    return np.array(kd)[:, None] / np.pi + np.array(a)[:, None] * lobe


MODELS = {"ggx": ggx, "lambert": lambert, "abc": abc}


def value(description, light, camera):
    (kind, parameters), = description.items()
    return MODELS[kind](Pair(light, camera), **parameters)


def isotropic(description):
    return all(lobe["alpha"][0] == lobe["alpha"][1] for lobe in description.get("ggx", {}).get("lobes", []))


def about_mirror(camera, chi, zeta):
    """Angles of the directions at chi from the mirror direction of the camera, at bearing zeta from the normal."""
    theta_m, phi_m = camera[0], camera[1] + np.pi
    cos_theta = np.cos(theta_m) * np.cos(chi) + np.sin(theta_m) * np.sin(chi) * np.cos(zeta)
    along = np.sin(theta_m) * np.cos(chi) - np.cos(theta_m) * np.sin(chi) * np.cos(zeta)
    across = np.sin(chi) * np.sin(zeta)
    return np.arctan2(np.hypot(along, across), cos_theta), phi_m + np.arctan2(across, along)


def nodes(camera, n_chi=96, n_zeta=128):
    u, zeta = np.meshgrid((np.arange(n_chi) + 0.5) / n_chi, (np.arange(n_zeta) + 0.5) * 2 * np.pi / n_zeta)
    chi = np.pi * u**3
    weight = np.sin(chi) * 3 * np.pi * u**2 / n_chi * 2 * np.pi / n_zeta
    theta, phi = about_mirror(camera, chi, zeta)
    keep = theta <= np.radians(85)
    return (theta[keep], phi[keep]), weight[keep]


def albedo(description, camera, n=400):
    """Gauss-Legendre in u where the angle to the mirror direction is u^2 times its value at the horizon."""
    x, w = np.polynomial.legendre.leggauss(n)
    u, zeta = np.meshgrid((x + 1) / 2, (np.arange(n) + 0.5) * 2 * np.pi / n)
    w_u = np.broadcast_to(w / 2, u.shape)
    # On a great circle towards zeta the normal component is cos(theta_m) cos(chi) + sin(theta_m) cos(zeta) sin(chi).
    horizon = np.arctan2(np.cos(camera[0]), -np.sin(camera[0]) * np.cos(zeta))
    chi = horizon * u**2
    light = about_mirror(camera, chi, zeta)
    weight = (w_u * 2 * u * horizon * np.sin(chi) * 2 * np.pi / n * np.cos(light[0])).ravel()
    return value(description, tuple(angle.ravel() for angle in light), camera) @ weight


def with_mean(rgb):
    """The channels after their mean."""
    return np.concatenate([rgb.mean(axis=0, keepdims=True), rgb])


def metric(truth, model, zone_deg):
    lo, hi = np.radians(zone_deg)
    azimuths = [0.0] if isotropic(truth) else [0.0, np.pi / 2]
    found = {key: [] for key in ("rel_in", "rel_out", "log_in", "log_out")}
    for camera in [(np.radians(t), phi) for phi in azimuths for t in THETA_O]:
        light, w = nodes(camera)
        cos = np.cos(light[0])
        t, m = (with_mean(value(description, light, camera)) for description in (truth, model))
        t = np.maximum(t, 0)
        rms = np.sqrt(np.average((t * cos) ** 2, axis=1, weights=w))
        ratio = np.log((np.maximum(m, 0) + FLOOR) / (t + FLOOR))
        inside = (light[0] >= lo) & (light[0] <= hi) & (lo <= camera[0] <= hi)
        for name, part in (("in", inside), ("out", ~inside)):
            if part.any():
                square = np.average(((m - t) * cos)[:, part] ** 2, axis=1, weights=w[part])
                found["rel_" + name].append(np.sqrt(square) / rms)
                square = np.average(ratio[:, part] ** 2, axis=1, weights=(w * cos)[part])
                found["log_" + name].append(np.sqrt(square))
    result = {key: np.mean(rows, axis=0) for key, rows in found.items()}
    mean_albedo = lambda d, t: with_mean(np.mean([albedo(d, (np.radians(t), phi)) for phi in azimuths], axis=0)[:, None])
    result["albedo_error"] = np.hstack([mean_albedo(model, t) / mean_albedo(truth, t) - 1 for t in ALBEDO_AT])
    return result


def main():
    asked = json.load(open(sys.argv[1]))
    tolerance, failed = asked["tolerance"], []
    for case in asked["cases"]:
        want = metric(case["truth"], case["model"], case["zone_deg"])
        channels = [case["errors"], *case["errors"]["per_channel"]]
        worst = worst_albedo = 0.0
        for c, errors in enumerate(channels):
            for key, expected in want.items():
                got = np.array(errors[key])
                if key == "albedo_error":
                    worst_albedo = max(worst_albedo, np.max(np.abs(got - expected[c])))
                else:
                    worst = max(worst, abs(got / expected[c] - 1))
        figures = ", ".join(f"{key} {case['errors'][key]:.4f}" for key in list(want)[:4])
        print(f"{case['name']}: {figures}; differ by {worst:.1e} (relative), albedos by {worst_albedo:.1e}")
        # A NaN compares false.
        if not (worst <= tolerance["errors"] and worst_albedo <= tolerance["albedo"]):
            failed.append(case["name"])
    if failed:
        sys.exit("above tolerance: " + "; ".join(failed))


main()
