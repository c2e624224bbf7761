"""Associated Legendre functions and their integrals from exact polynomials, for peers at 50 digits and more.

Nothing here shares a formula with the Rust code: polynomials come from Rodrigues' formula with integer coefficients,
the norm from factorials. No Condon-Shortley phase.
"""
from functools import lru_cache
from math import comb, factorial

import mpmath as mp

# 50 digits must survive sums with alternating terms up to 2^50 times the result.
mp.mp.dps = 90


@lru_cache(maxsize=None)
def polynomial(l, m):
    """(coefficients, lowest first, odd) of q in P_lm = (1 - x^2)^(m/2) q(x): q = x^odd times a polynomial in x^2."""
    full = [0] * (l + 1)
    for i in range(l // 2 + 1):
        full[l - 2 * i] = (-1) ** i * comb(l, i) * comb(2 * l - 2 * i, l)
    for _ in range(m):
        full = [k * c for k, c in enumerate(full)][1:]
    odd = (l - m) % 2
    return [mp.mpf(c) / 2**l for c in full[odd::2]], odd


def evaluate(l, m, x):
    """q(x)."""
    coefficients, odd = polynomial(l, m)
    value, x2 = mp.mpf(0), x * x
    for c in reversed(coefficients):
        value = value * x2 + c
    return value * x if odd else value


@lru_cache(maxsize=None)
def norm_on_sphere(l, m):
    return mp.sqrt(mp.mpf((2 * l + 1) * factorial(l - m)) / (4 * mp.pi * factorial(l + m)))


class Zone:
    """A zone b <= mu <= a and its normalised polar parts N_lm P_lm(x')."""

    def __init__(self, a, b):
        self.a, self.b = mp.mpf(a), mp.mpf(b)
        self.scale = mp.sqrt(2 / (self.a - self.b))

    def stretch(self, mu):
        """x' and 1 - x'^2."""
        width = self.a - self.b
        return (2 * mu - self.a - self.b) / width, 4 * (self.a - mu) * (mu - self.b) / width**2

    def polar(self, l, m, mu):
        """Outside the zone |1 - x'^2| is taken, as the Rust code says."""
        x, s2 = self.stretch(mu)
        return self.scale * norm_on_sphere(l, m) * mp.sqrt(abs(s2)) ** m * evaluate(l, m, x)


SPHERE = Zone(1, -1)


@lru_cache(maxsize=None)
def gauss_legendre(n):
    """Nodes and weights on [-1, 1]: Newton's method on the exact polynomial."""
    rule = []
    for i in range(n):
        x = mp.cos(mp.pi * (i + mp.mpf(3) / 4) / (n + mp.mpf(1) / 2))
        for _ in range(10):
            x -= evaluate(n, 0, x) / evaluate(n, 1, x)
        rule.append((x, 2 / ((1 - x * x) * evaluate(n, 1, x) ** 2)))
    return rule


def integral_of_polynomial(f, zone, degree):
    """2 pi integral of f dmu over the zone, exact if f is a polynomial of at most this degree."""
    half, middle = (zone.a - zone.b) / 2, (zone.a + zone.b) / 2
    return 2 * mp.pi * half * mp.fsum(w * f(middle + half * x) for x, w in gauss_legendre(degree // 2 + 1))


def chebyshev_nodes(zone, n):
    """Nodes mu and weights of the Gauss-Chebyshev rule of the second kind: weight sqrt(1 - x'^2)."""
    half, middle = (zone.a - zone.b) / 2, (zone.a + zone.b) / 2
    nodes = []
    for i in range(1, n + 1):
        angle = mp.pi * i / (n + 1)
        nodes.append((middle + half * mp.cos(angle), half * mp.pi / (n + 1) * mp.sin(angle) ** 2))
    return nodes


def gram(zone, m, degrees):
    """G_kl = 2 pi integral P_k(mu) P_l(mu) dmu: polynomials for every m."""
    top = 2 * max(degrees)
    product = lambda k, l: integral_of_polynomial(lambda mu: SPHERE.polar(k, m, mu) * SPHERE.polar(l, m, mu), zone, top)
    return mp.matrix([[product(k, l) for l in degrees] for k in degrees])


def mixed(zone, m, degrees, columns, nodes=200):
    """B_kj = 2 pi integral P_k(mu) P_j(x') dmu: a polynomial for even m, with two square roots for odd m."""
    if m % 2 == 0:
        top = max(degrees) + max(columns)
        entry = lambda k, j: integral_of_polynomial(lambda mu: SPHERE.polar(k, m, mu) * zone.polar(j, m, mu), zone, top)
        return mp.matrix([[entry(k, j) for j in columns] for k in degrees])
    # The weight sqrt(1 - x'^2) is taken out of P_j; what is left is analytic in the zone.
    rule = chebyshev_nodes(zone, nodes)
    left = [[SPHERE.polar(k, m, mu) for mu, _ in rule] for k in degrees]
    right = [[w * zone.polar(j, m, mu) / mp.sqrt(zone.stretch(mu)[1]) for mu, w in rule] for j in columns]
    return mp.matrix([[2 * mp.pi * mp.fdot(p, q) for q in right] for p in left])


def largest(matrix):
    return max(abs(x) for x in matrix)
