"""Mie phase functions of water droplets, averaged over a narrow size range: writes mie.json.

What: unpolarised light of 550 nm (in air, taken as vacuum), refractive index
1.333, no absorption. A single size has ripple, so each diameter stands for a
gamma distribution (Hansen & Travis 1974): n(r) ~ r^((1-3b)/b) exp(-r/(a b)),
effective radius a = diameter / 2 (the ratio of the 3rd to the 2nd moment),
effective variance b = 0.05. Sizes are weighted by n(r) times their scattering
cross-section. The scattered intensity is 1/sr and integrates to 1 over the
sphere. One wavelength only: no average over the visible spectrum.

The published fit of Jendersie & d'Eon 2023 to Mie is evaluated here for
comparison and printed; it is not written to the file.

Run (about a minute, one thread):
    python3 -m venv v && v/bin/pip install miepython==3.3.0 numpy==2.4.6
    v/bin/python make_mie.py

Sources: Mie coefficients from miepython (Prahl; method of Wiscombe 1980); the
angular functions and sums are those of Bohren & Huffman 1983, ch. 4, done here
for many sizes at once and checked against miepython. Hansen & Travis 1974,
"Light scattering in planetary atmospheres". Jendersie & d'Eon 2023, "An
Approximate Mie Scattering Function for Fog and Cloud Rendering".
"""
import os
for v in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(v, "1")
os.environ.setdefault("MIEPYTHON_USE_JIT", "1")
import json
from importlib.metadata import version
from pathlib import Path

import miepython
import numpy as np

M = 1.333
LAMBDA = 0.55
B = 0.05
DIAMETERS = (5, 10, 20, 30, 50)
DX = {5: 0.01, 10: 0.01, 20: 0.02, 30: 0.025, 50: 0.05}  # steps in size parameter
SPAN = (0.2, 2.6)  # of the effective radius
FRACTIONS = (1, 5, 10, 30)
ANGLES = [0, .05, .1, .15, .2, .3, .4, .5, .6, .7, .8, .9, 1, 1.2, 1.5, 1.75, 2, 2.5, 3, 3.5, 4, 5,
          6, 7, 8, 10, 12, 14, 16, 18, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 85, 90,
          95, 100, 105, 110, 115, 120, 125, 130, 134, 136, 138, 140, 142, 144, 146, 148, 150, 155,
          160, 165, 170, 174, 176, 177, 178, 178.5, 179, 179.25, 179.5, 179.75, 180]


def angular(mu, nmax):
    """pi_n and tau_n times (2n+1)/(n(n+1)), shape (nmax, angles)."""
    p = np.zeros((nmax + 1, len(mu)))
    t = np.zeros_like(p)
    p[1] = 1
    t[1] = mu
    for n in range(2, nmax + 1):
        p[n] = (2 * n - 1) / (n - 1) * mu * p[n - 1] - n / (n - 1) * p[n - 2]
        t[n] = n * mu * p[n] - (n + 1) * p[n - 1]
    n = np.arange(1, nmax + 1)[:, None]
    c = (2 * n + 1) / (n * (n + 1))
    return c * p[1:], c * t[1:]


def sums(xs, weights, mu):
    """Weighted sums over sizes: scattered intensity at mu, its integral, and g."""
    sets = [miepython.an_bn(M, x) for x in xs]
    nmax = max(len(a) for a, _ in sets)
    a = np.zeros((len(xs), nmax), complex)
    b = np.zeros_like(a)
    for i, (ai, bi) in enumerate(sets):
        a[i, : len(ai)], b[i, : len(bi)] = ai, bi
    n = np.arange(1, nmax + 1)
    # in units where the intensity is (|S1|^2 + |S2|^2) / 2
    total = 2 * np.pi * ((2 * n + 1) * (abs(a) ** 2 + abs(b) ** 2)).sum(1)
    k, nn = n[:-1], nmax - 1
    gs = (k * (k + 2) / (k + 1) * (a[:, :nn] * a[:, 1:].conj() + b[:, :nn] * b[:, 1:].conj()).real).sum(1)
    gs += ((2 * n + 1) / (n * (n + 1)) * (a * b.conj()).real).sum(1)
    gs *= 4 * np.pi
    p, t = angular(mu, nmax)
    s = np.zeros(len(mu))
    for i in range(0, len(xs), 500):
        ai, bi, w = a[i:i + 500], b[i:i + 500], weights[i:i + 500]
        for c, d in ((ai, bi), (bi, ai)):
            re = c.real @ p + d.real @ t
            im = c.imag @ p + d.imag @ t
            s += w @ (re * re + im * im) / 2
    return s, weights @ total, weights @ gs


def grid():
    """The listed angles, then Gauss points for each interval between FRACTIONS."""
    th, wt, edges = [np.radians(ANGLES)], [], (0,) + FRACTIONS + (180,)
    parts = []
    for lo, hi, n in zip(edges, edges[1:], (40, 100, 100, 300, 1400)):
        x, q = np.polynomial.legendre.leggauss(n)
        h = np.radians(hi - lo) / 2
        t = np.radians(lo) + h * (x + 1)
        th.append(t)
        wt.append(2 * np.pi * np.sin(t) * q * h)
        parts.append(n)
    return np.concatenate(th), wt, parts


def averaged(d, dx, b=B):
    a = np.pi * d / LAMBDA  # effective size parameter
    xs = np.arange(SPAN[0] * a, SPAN[1] * a, dx)
    r = xs / a
    n = np.exp((1 - 3 * b) / b * np.log(r) - (r - 1) / b)
    reff = (n @ xs**3) / (n @ xs**2)
    veff = (n @ ((xs - reff) ** 2 * xs**2)) / (n @ xs**2) / reff**2
    assert abs(reff / a - 1) < 1e-4 and abs(veff / b - 1) < 1e-2, (reff / a, veff)
    th, wt, parts = grid()
    s, total, gs = sums(xs, n, np.cos(th))
    phase = s / total
    k = len(ANGLES)
    shares = []
    g = 0.0
    for w in wt:
        f = phase[k:k + len(w)]
        shares.append(float(w @ f))
        g += float((w * np.cos(th[k:k + len(w)])) @ f)
        k += len(w)
    assert abs(sum(shares) - 1) < 1e-9, sum(shares)
    assert abs(g - gs / total) < 1e-9, (g, gs / total)
    return phase[: len(ANGLES)], g, np.cumsum(shares)[:-1], (th, phase)


def checks():
    mu = np.cos(np.radians([0, 0.3, 1, 5, 42, 90, 138, 179.5, 180]))
    for x in (28.56, 114.2, 400.3):
        s, total, g = sums(np.array([x]), np.ones(1), mu)
        want = miepython.i_unpolarized(M, x, mu, norm="one")
        qe, qs, _, gw = miepython.efficiencies_mx(M, x)
        assert abs(qe / qs - 1) < 1e-9
        assert np.max(abs(s / total / want - 1)) < 1e-7, s / total / want
        assert abs(g / total - gw) < 1e-9
        assert abs(total / (np.pi * x * x) / qs - 1) < 1e-9
    # large spheres: half of the extinction is diffraction; peak ~ x^2 / (4 pi) of it
    s, total, _ = sums(np.array([400.3]), np.ones(1), np.array([1.0]))
    assert abs(s[0] / total / (400.3**2 / (4 * np.pi)) / 0.5 - 1) < 0.05
    print("single sizes agree with miepython; energy, g and diffraction peak check")


def fit(d, mu):
    ghg = np.exp(-0.0990567 / (d - 1.67154))
    gd = np.exp(-2.20679 / (d + 3.91029) - 0.428934)
    al = np.exp(3.62489 - 8.29288 / (d + 5.52825))
    w = np.exp(-0.599085 / (d - 0.641583) - 0.665888)
    hg = lambda g: (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * mu) ** 1.5)
    draine = hg(gd) * (1 + al * mu * mu) / (1 + al * (1 + 2 * gd * gd) / 3)
    return (1 - w) * hg(ghg) + w * draine


def main():
    checks()
    out = []
    for d in DIAMETERS:
        p, g, within, (th, full) = averaged(d, DX[d])
        rows = [[a, float(f"{v:.6g}")] for a, v in zip(ANGLES, p)]
        # convergence: sharp resonances make the size step matter; compare with twice the step
        p2, g2, w2, _ = averaged(d, 2 * DX[d])
        rel, ang = abs(p2 / p - 1), np.array(ANGLES)
        conv = {k: float(f"{rel[m].max():.1e}") for k, m in (
            ("0_10_deg", ang <= 10), ("10_170_deg", (ang > 10) & (ang <= 170)), ("170_180_deg", ang > 170))}
        conv["g"] = float(f"{abs(g2 - g):.1e}")
        conv["energy"] = float(f"{np.max(abs(w2 - within)):.1e}")
        out.append({"diameter_um": d, "g": float(f"{g:.7f}"),
                    "energy_within_deg": {str(a): float(f"{f:.7f}") for a, f in zip(FRACTIONS, within)},
                    "err": conv, "phase": rows})
        k = len(ANGLES)
        mt, mp = th[k:], full[k:]
        q = np.concatenate(grid()[1])
        f = fit(d, np.cos(mt))
        # the fit's forward peak is narrower than the first interval's points
        # can see at large d, so its energies are integrated in log(1 - mu)
        u = np.linspace(np.log(1e-14), np.log(2), 400001)
        y = np.exp(u)
        dens = 2 * np.pi * fit(d, 1 - y) * y
        cum = np.concatenate([[0], np.cumsum((dens[1:] + dens[:-1]) / 2 * np.diff(u))])
        fg = np.trapezoid(dens * (1 - y), u)
        fw = np.interp(np.log(1 - np.cos(np.radians(FRACTIONS))), u, cum)
        x = np.radians(np.linspace(10, 170, 321))
        lm = np.interp(x, mt, np.log10(mp))
        lf = np.log10(fit(d, np.cos(x)))
        dev = lf - lm
        worst = np.argmax(abs(dev))
        print(f"d {d:2d}: g {g:.6f}, fit-Mie {fg - g:+.5f} (fit norm {cum[-1]:.6f}); p(0) {p[0]:.5g}, fit/Mie "
              f"{fit(d, 1.0) / p[0]:.3f}; rms log10 10..170 deg {np.sqrt(np.mean(dev**2)):.3f}, "
              f"worst {dev[worst]:+.2f} at {np.degrees(x[worst]):.0f}", "step change", conv)
        print("      energy within", FRACTIONS, "Mie", np.round(within, 5), "fit", np.round(fw, 5))
        print("      fit/Mie at", " ".join(f"{a}:{fit(d, np.cos(np.radians(a))) / v:.2f}" for a, v in zip(ANGLES, p)
                                        if a in (0.1, 0.5, 1, 2, 5, 10, 30, 60, 90, 120, 140, 160, 180)))
    top = {"about": "Mie phase functions of water droplets, size-averaged; see make_mie.py",
           "solver": "miepython " + version("miepython"), "refractive_index": M,
           "wavelength_um": LAMBDA, "size_distribution": "gamma, by effective radius and effective variance",
           "effective_variance": B, "phase_unit": "1/sr, integral over the sphere 1",
           "phase_columns": ["angle_deg", "value"]}
    text = json.dumps(top, indent=1)[:-2] + ',\n "droplets": [\n'
    blocks = []
    for o in out:
        rows = o.pop("phase")
        lines = [", ".join(json.dumps(r) for r in rows[i:i + 6]) for i in range(0, len(rows), 6)]
        blocks.append("  " + json.dumps(o)[:-1] + ',\n   "phase": [\n    ' + ",\n    ".join(lines) + "]}")
        o["phase"] = rows
    text += ",\n".join(blocks) + "\n ]\n}\n"
    assert json.loads(text)["droplets"] == out
    Path(__file__).with_name("mie.json").write_text(text)
    print(len(text), "bytes")


if __name__ == "__main__":
    main()
