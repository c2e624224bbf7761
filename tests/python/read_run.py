"""A run folder and its conversion with OpenEXR, json and NumPy alone: `read_run.py cases.json`, from tests/peers_run.rs.

Nothing here knows more than the folder itself says: run.json, journal.jsonl and the attributes in the files' headers.
"""
import json
import sys
from math import factorial
from pathlib import Path

import numpy as np
import OpenEXR

MEASURE_KEYS = (
    "order images frames rig_s rig_s_items compute_s post_s zone_deg noise_rel saturated_fraction "
    "format software status rig plan provenance"
).split()
ATTRIBUTES = "zonal_content zonal_units zonal_convention zonal_order zonal_theta_min_deg zonal_theta_max_deg".split()


def check(condition, message):
    if not condition:
        sys.exit(message)


def read(path):
    """Attributes and planes of an OpenEXR file; OpenEXR gives numbers as arrays of one."""
    with OpenEXR.File(str(path), separate_channels=True) as image:
        header = {key: value for key, value in image.header().items() if key.startswith("zonal_")}
        planes = {name: channel.pixels.astype(np.float64) for name, channel in image.channels().items()}
    for key, value in header.items():
        header[key] = value if isinstance(value, str) else float(np.ravel(value)[0])
    check(header.get("zonal_format") == 1, f"{path}: zonal_format is not 1")
    check("zonal_content" in header and header.get("zonal_software", "").startswith("zonal "), f"{path}: {header}")
    return header, planes


def stack(planes, stem, count, path):
    """Planes stem_kkk.R|G|B as one array [k, channel, row, column]."""
    names = [[f"{stem}_{k:03}.{c}" for c in "RGB"] for k in range(count)]
    missing = [name for row in names for name in row if name not in planes]
    check(not missing, f"{path}: no planes {missing}")
    return np.array([[planes[name] for name in row] for row in names])


def coefficients(path, value, order_key, record):
    """Values of an expansion; its standard errors are checked."""
    header, planes = read(path)
    check(all(key in header for key in ATTRIBUTES), f"{path}: attributes are missing: {sorted(header)}")
    check("sr" in header["zonal_units"], f"{path}: units {header['zonal_units']}")
    check(header["zonal_order"] == record["order"], f"{path}: zonal_order {header['zonal_order']}")
    zone = [header["zonal_theta_min_deg"], header["zonal_theta_max_deg"]]
    check(np.allclose(zone, record["zone_deg"], rtol=0, atol=1e-9), f"{path}: zone {zone}")
    count = (int(header[order_key]) + 1) ** 2
    values, sigma = stack(planes, value, count, path), stack(planes, "sigma", count, path)
    check(np.isfinite(values).all(), f"{path}: values that are not finite")
    return header, values, sigma


def legendre(l, m, x):
    """P_lm without the Condon-Shortley phase, from the polynomial (x^2 - 1)^l / (2^l l!) differentiated l + m times."""
    derivative = np.polynomial.Polynomial([-1, 0, 1]) ** l / (2**l * factorial(l))
    return (1 - x * x) ** (m / 2) * derivative.deriv(l + m)(x) if l + m else np.ones_like(x)


def harmonics(order, theta, phi):
    """Y_k as `zonal_functions` in the header gives them, [k, direction]."""
    rows = []
    for l in range(order + 1):
        for m in range(-l, l + 1):
            n = np.sqrt((2 * l + 1) / (4 * np.pi) * factorial(l - abs(m)) / factorial(l + abs(m)))
            around = 1 if m == 0 else np.sqrt(2) * (np.cos(m * phi) if m > 0 else np.sin(-m * phi))
            rows.append(n * legendre(l, abs(m), np.cos(theta)) * around)
    return np.array(rows)


def bilinear(tables, zone_deg, theta, phi):
    """`tables` [k, channel, row, column] at directions, as `zonal_interpolation` in the header says."""
    rows, columns = tables.shape[2:]
    lo, hi = np.radians(zone_deg)
    row = np.clip((theta - lo) / (hi - lo) * rows - 0.5, 0, rows - 1)
    column = phi / (2 * np.pi) * columns - 0.5
    r, c = np.floor(row).astype(int), np.floor(column).astype(int)
    below, right = row - r, column - c
    at = lambda dr, dc: tables[:, :, np.minimum(r + dr, rows - 1), (c + dc) % columns]
    upper = (1 - right) * at(0, 0) + right * at(0, 1)
    lower = (1 - right) * at(1, 0) + right * at(1, 1)
    return (1 - below) * upper + below * lower


def check_folder(run):
    record = json.loads((run / "run.json").read_text())
    missing = [key for key in MEASURE_KEYS if key not in record]
    check(not missing, f"run.json: no keys {missing}")
    check(record["status"] == "complete", f"run.json: status {record['status']}")
    check(record["images"] == 2 * (record["order"] + 1) ** 2, "run.json: images")
    items = record["rig_s_items"]
    check(np.isclose(sum(items.values()), record["rig_s"]), f"run.json: {items} do not add up to {record['rig_s']}")

    journal = [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()]
    check(journal[0]["event"] == "prepared", f"journal.jsonl begins with {journal[0]}")
    frames = [entry for entry in journal if entry["event"] == "frame"]
    check(len(frames) == record["frames"], f"journal.jsonl: {len(frames)} frames, run.json says {record['frames']}")
    check([entry["index"] for entry in frames] == list(range(len(frames))), "journal.jsonl: indices")
    keys = {"event", "index", "repeat", "k", "sign", "exposure", "exposure_s", "gain", "sequence", "timestamp_s"}
    keys |= {"light", "light_reading"}
    check(all(set(entry) == keys for entry in frames), f"journal.jsonl: keys are {sorted(frames[0])}")

    responses = sorted((run / "responses").iterdir())
    check(len(responses) == record["images"], f"{len(responses)} responses for {record['images']} images")
    for path in responses:
        header, planes = read(path)
        check({"zonal_units", "zonal_crop_u0_px", "zonal_crop_v0_px"} <= set(header), f"{path}: {sorted(header)}")
        check(set(planes) == {"rate", "variance"}, f"{path}: planes {sorted(planes)}")
        seen = ~np.isnan(planes["rate"])
        check(seen.any() and (planes["variance"][seen] > 0).all(), f"{path}: variances that are not positive")
    return record


def main():
    cases = json.load(open(sys.argv[1]))
    run = Path(cases["run"])
    record = check_folder(run)

    _, _, sigma = coefficients(run / "coefficients.exr", "z", "zonal_order", record)
    check((sigma > 0).all(), "coefficients.exr: standard errors that are not positive")

    header, y, sigma = coefficients(Path(cases["sh"]), "y", "zonal_sh_order", record)
    check({"zonal_functions", "zonal_interpolation", "zonal_method"} <= set(header), f"sh: {sorted(header)}")
    # Parity leaves out the functions with l + m even: exact zeros.
    used = np.array([(l + m) % 2 == 1 for l in range(int(header["zonal_sh_order"]) + 1) for m in range(-l, l + 1)])
    check((sigma[used] > 0).all() and (sigma[~used] == 0).all(), "sh: standard errors")

    pairs = cases["pairs"]
    theta_i, phi_i = np.array([pair["wi"] for pair in pairs]).T
    theta_o, phi_o = np.array([pair["wo"] for pair in pairs]).T
    zone = [header["zonal_theta_min_deg"], header["zonal_theta_max_deg"]]
    f_cos = np.einsum(
        "kn,kcn->nc", harmonics(int(header["zonal_sh_order"]), theta_i, phi_i), bilinear(y, zone, theta_o, phi_o)
    )
    want = np.array([pair["f_cos"] for pair in pairs])
    error = np.abs(f_cos - want).max() / np.abs(want).max()
    print(f"{len(pairs)} pairs: worst error {error:.1e} of the largest |f_cos|")
    check(error <= cases["tolerance"], f"above {cases['tolerance']:.1e}")


main()
