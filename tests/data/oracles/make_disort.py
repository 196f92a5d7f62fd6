"""Reference fluxes and radiances of plane-parallel slabs: writes disort.json.

What: one homogeneous slab (optical depth tau, single-scattering albedo,
isotropic or Henyey-Greenstein phase function) over a black surface, nothing
incident but a collimated beam of irradiance 1 on a plane facing it (so the
horizontal irradiance at the top is mu0). Discrete ordinates, delta-M scaling.

Run (half a minute, one thread):
    python3 -m venv v && v/bin/pip install PythonicDISORT==1.8 numpy==2.4.6 scipy==1.17.1
    v/bin/python make_disort.py

Conservative scattering: the solver wants albedo < 1. "albedo 1" is therefore
the cubic extrapolation 4 f(1-e) - 6 f(1-2e) + 4 f(1-3e) - f(1-4e), e = 1e-5,
which leaves less than 1e-7 (closer to 1 the solver loses digits instead).

Directions: mu > 0 is the cosine of the angle from the vertical, dphi the
azimuth of the travelling light (radiance) minus the azimuth of the travelling
beam. dphi 0: light still moving the way the beam moves, horizontally; the
scattering cosine is  s mu mu0 + cos(dphi) sqrt(1-mu^2) sqrt(1-mu0^2)  with
s = -1 for reflected ("up", at the top), +1 for transmitted ("down", at the
bottom). Radiances are diffuse only: the beam itself is left out.

Every number is the solution with 128 streams; its error is the difference to
the solution with 64. Delta-M scaling matters for g = 0.85 only (g^64 = 3e-5).
Radiances: the light scattered once is known in closed form and is taken out
of the solution at the quadrature points, the smooth rest is interpolated in
mu, and the exact part is put back (this does what the intensity corrections
of delta-M do, at the direction asked for). At mu = 1 only the azimuthal mean
has a value, so only that mode enters. 32 azimuthal modes (0.5^32 = 2e-10).

Sources: Stamnes, Tsay, Wiscombe, Jayaweera 1988 (discrete ordinates);
Wiscombe 1977 (delta-M); Nakajima, Tanaka 1988 (single-scattering correction);
Ho 2024, "PythonicDISORT" (J. Open Source Software). The checks use Chandrasekhar 1950 (H function),
van de Hulst 1980 (thick conservative slabs), the published fluxes of the test
problems 1 and 3 that accompany DISORT (Stamnes et al. 2000), and a small
Monte Carlo of its own.
"""
import os
for v in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(v, "1")
import json
import warnings
from importlib.metadata import version
from pathlib import Path

import numpy as np
from PythonicDISORT.pydisort import pydisort

warnings.filterwarnings("ignore", message=".*close to 1.*")
warnings.filterwarnings("ignore", message=".*`NFourier` is large.*")

EPS = 1e-5
STREAMS = (64, 128)
FOURIER = 32
DIRS = [(1.0, 0), (0.5, 0), (0.5, 90), (0.5, 180)]


def coeffs(g):
    c = g ** np.arange(256.0)
    c[0] = 1.0
    return c


def hg(g, c):
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * c) ** 1.5)


def single(tau, w, g, mu0, mu, phi, s):
    """Radiance of light scattered once; s = 1 reflected, -1 transmitted."""
    c = -s * mu * mu0 + np.cos(phi) * np.sqrt((1 - mu**2) * (1 - mu0**2))
    if s > 0:
        k = -np.expm1(-tau * (1 / mu + 1 / mu0)) * mu0 / (mu + mu0)
    elif abs(mu - mu0) < 1e-9:
        k = tau / mu * np.exp(-tau / mu)
    else:
        k = mu0 * (np.exp(-tau / mu) - np.exp(-tau / mu0)) / (mu - mu0)
    return w * hg(g, c) * k


def at_mu(x, f, at):
    """The polynomial through (x, f), x Gauss-Legendre points of [0, 1], at `at`."""
    k = np.argsort(x)
    x, f = x[k], f[k]
    w = np.polynomial.legendre.leggauss(len(x))[1]
    c = (-1.0) ** np.arange(len(x)) * np.sqrt(x * (1 - x) * w) / (at - x)
    return float(c @ f / c.sum())


def raw_flux(tau, w, g, mu0, n):
    c = coeffs(g)
    _, fp, fm, _ = pydisort(tau, w, n, c, mu0, 1.0, 0.0, only_flux=True, f_arr=c[n])
    dif, beam = fm(tau)
    return np.array([fp(0.0), dif, beam]).ravel() / mu0


def raw_rad(tau, w, g, mu0, n):
    mus, _, _, u0, u = pydisort(tau, w, n, coeffs(g), mu0, 1.0, 0.0, NFourier=FOURIER)
    x = mus[: n // 2]
    ring = (np.arange(256) + 0.5) * np.pi / 256
    out = []
    for s, t, part in ((1, 0.0, slice(0, n // 2)), (-1, tau, slice(n // 2, n))):
        for mu, dphi in DIRS:
            phi = np.radians(dphi)
            if mu == 1:
                once = np.array([single(tau, w, g, mu0, m, ring, s).mean() for m in x])
                full = np.ravel(u0(t))[part]
            else:
                once = np.array([single(tau, w, g, mu0, m, phi, s) for m in x])
                full = np.ravel(u(t, phi))[part]
            out.append(at_mu(x, full - once, mu) + single(tau, w, g, mu0, mu, phi, s))
    return np.array(out)


def solve(f, tau, w, g, mu0, n):
    if w < 1:
        return f(tau, w, g, mu0, n)
    return sum(a * f(tau, 1 - k * EPS, g, mu0, n) for k, a in ((1, 4), (2, -6), (3, 4), (4, -1)))


def both(f, *a):
    lo, hi = (solve(f, *a, n) for n in STREAMS)
    return hi, np.abs(hi - lo)


# ---------------------------------------------------------------- checks


def h_function(w):
    """Chandrasekhar's H for isotropic scattering, by iteration; returns H(mu)."""
    x, q = np.polynomial.legendre.leggauss(200)
    x, q = (x + 1) / 2, q / 2
    x, q = x**3, q * 3 * x**2  # more points where H is steep
    root = np.sqrt(1 - w)
    step = lambda m, h: 1 / (root + w / 2 * np.sum(q * x * h / (m[:, None] + x), axis=1))
    h = np.ones_like(x)
    for _ in range(20000):
        new = 0.5 * (h + step(x, h))
        done = np.max(np.abs(new - h)) < 1e-13
        h = new
        if done:
            break
    return lambda m: float(step(np.array([m]), h)[0])


def monte_carlo(tau, w, g, mu0, n, seed):
    """Fluxes and radiances (at DIRS) by following photons; with standard errors."""
    rng = np.random.default_rng(seed)
    blocks = []
    for _ in range(20):
        m = n // 20
        d = np.tile([np.sqrt(1 - mu0**2), 0.0, -mu0], (m, 1))
        z, wt = np.zeros(m), np.ones(m)
        res = np.zeros(3 + 2 * len(DIRS))
        first = True
        while len(z):
            z = z - d[:, 2] * -np.log1p(-rng.random(len(z)))
            up, dn = z < 0, z > tau
            res[0] += wt[up].sum()
            res[2 if first else 1] += wt[dn].sum()
            first = False
            keep = ~(up | dn)
            z, d, wt = z[keep], d[keep], wt[keep] * w
            for i, s in enumerate((1, -1)):
                for j, (mu, dphi) in enumerate(DIRS):
                    r = np.sqrt(1 - mu**2)
                    o = np.array([r * np.cos(np.radians(dphi)), r * np.sin(np.radians(dphi)), s * mu])
                    path = (z if s > 0 else tau - z) / mu
                    res[3 + 4 * i + j] += np.sum(wt * hg(g, d @ o) * np.exp(-path)) / mu * mu0
            live = rng.random(len(z)) < 0.5 + 0.5 * (wt > 0.1)
            wt = np.where(wt > 0.1, wt, 2 * wt)[live]
            z, d = z[live], d[live]
            e = rng.random(len(z))
            if g:
                c = (1 + g * g - ((1 - g * g) / (1 - g + 2 * g * e)) ** 2) / (2 * g)
            else:
                c = 2 * e - 1
            p, sn = 2 * np.pi * rng.random(len(z)), np.sqrt(1 - c * c)
            k = np.where(np.abs(d[:, 2:3]) < 0.9, [[0.0, 0, 1]], [[1.0, 0, 0]])
            a = np.cross(d, k)
            a /= np.linalg.norm(a, axis=1, keepdims=True)
            b = np.cross(d, a)
            d = c[:, None] * d + sn[:, None] * (np.cos(p)[:, None] * a + np.sin(p)[:, None] * b)
            d /= np.linalg.norm(d, axis=1, keepdims=True)
        blocks.append(res / m)
    b = np.array(blocks)
    return b.mean(0), b.std(0, ddof=1) / np.sqrt(len(b))


def close(name, got, want, rel):
    err = abs(got / want - 1)
    print(f"  {name}: {got:.7g}, expected {want:.7g}, relative difference {err:.1e}")
    assert err < rel, name


def checks():
    n = STREAMS[1]
    print("published DISORT fluxes (they used 16 streams; so does this check)")
    for tau, g, mu0, up, dn in (
        (0.03125, 0.0, 0.1, 4.22922e-1, 4.20233e-1),
        (32.0, 0.0, 0.1, 3.07390, 6.76954e-2),
        (1.0, 0.75, 1.0, 2.47374e-1, 1.73849),
        (8.0, 0.75, 1.0, 1.59096, 1.54958),
    ):
        # problem 1 has beam pi / mu0, problem 3 beam pi: horizontal irradiance pi in both
        r = solve(raw_flux, tau, 1.0, g, mu0, 16)
        close(f"tau {tau} g {g} reflected", np.pi * r[0], up, 1e-5)
        close(f"tau {tau} g {g} diffuse down", np.pi * r[1], dn, 1e-5)

    print("semi-infinite isotropic, albedo 0.9: H function")
    h = h_function(0.9)
    for mu0 in (1.0, 0.5):
        close(f"plane albedo mu0 {mu0}", raw_flux(64, 0.9, 0.0, mu0, n)[0],
              1 - np.sqrt(0.1) * h(mu0), 2e-6)
        rad = raw_rad(64, 0.9, 0.0, mu0, n)
        for j, mu in ((0, 1.0), (1, 0.5)):
            close(f"radiance mu0 {mu0} mu {mu}", rad[j],
                  0.9 / (4 * np.pi) * mu0 / (mu + mu0) * h(mu) * h(mu0), 2e-5)

    print("thick conservative isotropic: T = 4 K(mu0) / 3 / (tau + 2 * 0.710446)")
    h = h_function(1.0)
    close("H(1)", h(1.0), 2.907810, 2e-6)
    for tau in (16, 64):
        for mu0 in (1.0, 0.5):
            close(f"tau {tau} mu0 {mu0}", solve(raw_flux, tau, 1.0, 0.0, mu0, n)[1],
                  4 / 3 * np.sqrt(3) / 4 * h(mu0) / (tau + 2 * 0.7104461), 2e-6)

    print("thin limit, tau 0.001: radiance of one scattering (+ O(tau))")
    for g in (0.0, 0.5):
        rad = raw_rad(0.001, 0.9, g, 0.5, n)
        for i, s in enumerate((1, -1)):
            for j, (mu, dphi) in enumerate(DIRS):
                one = single(0.001, 0.9, g, 0.5, mu, np.radians(dphi), s)
                assert 0 < rad[4 * i + j] / one - 1 < 0.015, (g, mu, dphi, s)

    print("reciprocity of radiances: L(mu, mu0) / mu0 is symmetric")
    for tau in (0.1, 4):
        for i in (0, 4):
            close(f"tau {tau} side {i}", solve(raw_rad, tau, 1.0, 0.5, 0.5, n)[i] / 0.5,
                  solve(raw_rad, tau, 1.0, 0.5, 1.0, n)[i + 1], 2e-5)

    print("Monte Carlo (differences in standard errors)")
    for tau, w, g, mu0, k in ((1, 0.9, 0.5, 0.5, 200000), (4, 1.0, 0.0, 1.0, 50000),
                              (4, 0.9, 0.85, 0.5, 100000)):
        m, e = monte_carlo(tau, w, g, mu0, k, 1)
        f = solve(raw_flux, tau, w, g, mu0, n)
        f = np.concatenate([f, solve(raw_rad, tau, w, g, mu0, n)]) if g < 0.8 else f
        m, e = m[: len(f)], e[: len(f)]
        dev = (m - f) / np.maximum(e, 1e-12)
        print(f"  tau {tau} albedo {w} g {g} mu0 {mu0}:", np.round(dev, 1),
              "standard error / value: median", f"{np.median(e / f):.1e}")
        assert np.all(np.abs(dev) < 4.5)


# ---------------------------------------------------------------- output


def sig(v, n):
    return float(f"{v:.{n}g}")


def case(tau, w, g, mu0):
    f, e = both(raw_flux, tau, w, g, mu0)
    assert abs(f[2] - np.exp(-tau / mu0)) < 1e-12
    absorbed, ae = 1 - f.sum(), abs(e[0] + e[1])
    if w == 1:
        assert abs(absorbed) < 1e-7, absorbed
        absorbed = ae = 0.0
    c = {"tau": tau, "albedo": w, "g": g, "mu0": mu0,
         "flux": {"reflected": sig(f[0], 8), "diffuse": sig(f[1], 8),
                  "direct": sig(f[2], 8), "absorbed": sig(absorbed, 8)},
         "flux_err": {"reflected": sig(e[0], 2), "diffuse": sig(e[1], 2), "absorbed": sig(ae, 2)}}
    if g < 0.8:
        r, re = both(raw_rad, tau, w, g, mu0)
        c["radiance"] = []
        for i, side in enumerate(("up", "down")):
            for j, (mu, dphi) in enumerate(DIRS):
                if mu0 == 1 and dphi > 0:
                    continue  # the same in all azimuths
                k = 4 * i + j
                c["radiance"].append([side, mu, dphi, sig(r[k], 7), sig(re[k], 2)])
    return c


def main():
    checks()
    cases = [(tau, w, g, mu0) for tau in (0.1, 1, 4, 16, 64) for w in (1.0, 0.9)
             for g in (0.0, 0.5, 0.85) for mu0 in (1.0, 0.5, 0.2) if mu0 != 0.2 or tau == 1]
    data = [case(*c) for c in cases]
    top = {
        "about": "plane-parallel homogeneous slabs over black, beam irradiance 1; see make_disort.py",
        "solver": "PythonicDISORT " + version("PythonicDISORT"),
        "streams": STREAMS[1],
        "streams_compared": STREAMS[0],
        "phase": "Henyey-Greenstein with mean cosine g; g = 0 is isotropic",
        "albedo_1": f"cubic extrapolation from albedos 1-k*{EPS:g}, k = 1..4",
        "flux_unit": "fraction of the horizontal irradiance mu0",
        "radiance_unit": "per steradian, per unit beam irradiance; diffuse light only",
        "radiance_columns": ["side", "mu", "dphi_deg", "value", "err"],
    }
    text = json.dumps(top, indent=1)[:-2] + ',\n "cases": [\n'
    text += ",\n".join("  " + json.dumps(c).replace(', "flux":', ',\n   "flux":')
                       .replace(', "flux_err":', ',\n   "flux_err":')
                       .replace(', "radiance":', ',\n   "radiance":') for c in data)
    text += "\n ]\n}\n"
    assert json.loads(text)["cases"] == data
    Path(__file__).with_name("disort.json").write_text(text)
    print(len(data), "cases,", len(text), "bytes")
    for w in (1.0, 0.9):
        d = [c for c in data if c["albedo"] == w]
        print(f"albedo {w}: largest flux error", max(max(c["flux_err"].values()) for c in d))
    rel = [(r[4] / r[3], r, c["tau"], c["albedo"], c["g"], c["mu0"]) for c in data for r in c.get("radiance", [])]
    print("largest relative radiance errors", *sorted(rel, key=lambda v: -v[0])[:4], sep="\n  ")


if __name__ == "__main__":
    main()
