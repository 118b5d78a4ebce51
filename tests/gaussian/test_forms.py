"""Lemmas 1 and 2, theorems 1 and 2 proved by SymPy; the matrix formulas against them in numbers.

The proofs rest on a Stein recursion written here, independent of the library's.
"""

import itertools

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from seedslib.gaussian import fifth_degree, mean_of, mean_square_errors
from seedslib.gaussian.errors.forms import (
    cubic_errors,
    cubic_mean,
    linear_mean,
    quadratic_errors,
    quadratic_mean,
    quartic_errors,
    quartic_mean,
)


class Ring:
    """Polynomial ring of n Gaussian variables, their moments and free coefficients.

    `mean_of` is ``E x_i g = m_i E g + sum_j S_ij E dg/dx_j``, applied until no variable is left.
    """

    def __init__(self, n, extra=()):
        names = [f"x{i}" for i in range(n)] + [f"m{i}" for i in range(n)]
        pairs = [(i, j) for i in range(n) for j in range(i, n)]
        names += [f"S{i}_{j}" for i, j in pairs] + list(extra)
        self.ring, *generators = sp.ring(names, sp.QQ)
        self.n = n
        self.x = generators[:n]
        self.m = generators[n : 2 * n]
        self.S = np.empty((n, n), dtype=object)
        for (i, j), s in zip(pairs, generators[2 * n :], strict=False):
            self.S[i, j] = self.S[j, i] = s
        self.extra = generators[2 * n + len(pairs) :]

    def mean_of(self, polynomial):
        known = {}
        result = self.ring.zero
        for monomial, coefficient in polynomial.terms():
            rest = self.ring({(0,) * self.n + monomial[self.n :]: coefficient})
            result += rest * self._moment(monomial[: self.n], known)
        return result

    def _moment(self, alpha, known):
        if not any(alpha):
            return self.ring.one
        if alpha not in known:
            i = next(k for k, power in enumerate(alpha) if power)
            lower = tuple(power - (k == i) for k, power in enumerate(alpha))
            value = self.m[i] * self._moment(lower, known)
            for j, power in enumerate(lower):
                if power:
                    below = tuple(p - (k == j) for k, p in enumerate(lower))
                    value += power * self.S[i, j] * self._moment(below, known)
            known[alpha] = value
        return known[alpha]


def matrix(generators, rows, columns):
    return np.array(generators[: rows * columns], dtype=object).reshape(rows, columns)


def symmetric(generators, n):
    result = np.empty((n, n), dtype=object)
    for (i, j), g in zip(
        itertools.combinations_with_replacement(range(n), 2), generators, strict=False
    ):
        result[i, j] = result[j, i] = g
    return result


def trace(product):
    return sum(product[i, i] for i in range(len(product)))


@pytest.mark.parametrize("n", [2, 3])
def test_lemma_1(n):
    count = n * (n + 1) // 2
    R = Ring(n, [f"a{i}" for i in range(count)] + [f"b{i}" for i in range(count)])
    x, m, S = np.array(R.x), np.array(R.m), R.S
    A, B = symmetric(R.extra, n), symmetric(R.extra[count:], n)
    for i in range(n):
        assert R.mean_of((A @ x)[i]) == (A @ m)[i]
    assert R.mean_of(x @ A @ x) == trace(A @ S) + m @ A @ m
    bilinear = m @ B @ m + trace(B @ S)
    for i in range(n):
        cubic = 2 * (A @ S @ B @ m)[i] + (A @ m)[i] * bilinear
        assert R.mean_of((A @ x)[i] * (x @ B @ x)) == cubic
    quartic = (
        2 * trace(A @ S @ B @ S) + 4 * (m @ A @ S @ B @ m) + (trace(A @ S) + m @ A @ m) * bilinear
    )
    assert R.mean_of((x @ A @ x) * (x @ B @ x)) == quartic


def test_cubic_row_of_lemma_1_needs_a_symmetric_matrix():
    """The lemma asks for symmetric matrices in the quartic row, rightly, and not in the cubic."""
    R = Ring(2, [f"a{i}" for i in range(4)] + [f"b{i}" for i in range(4)])
    x, m, S = np.array(R.x), np.array(R.m), R.S
    A, B = matrix(R.extra, 2, 2), matrix(R.extra[4:], 2, 2)
    cubic = R.mean_of((A @ x)[0] * (x @ B @ x))
    level = m @ B @ m + trace(B @ S)
    assert cubic != 2 * (A @ S @ B @ m)[0] + (A @ m)[0] * level
    assert cubic == (A @ S @ (B + B.T) @ m)[0] + (A @ m)[0] * level
    assert cubic != 2 * (A @ S @ B.T @ m)[0] + (A @ m)[0] * level
    quartic = R.mean_of((x @ A @ x) * (x @ B @ x))
    ends = (trace(A @ S) + m @ A @ m) * level
    assert quartic != 2 * trace(A @ S @ B @ S) + 4 * (m @ A @ S @ B @ m) + ends


@pytest.mark.parametrize("n", [2, 3])
def test_lemma_2(n):
    R = Ring(3 * n)
    u, v, w = (np.array(R.x[k * n : (k + 1) * n]) for k in range(3))
    a, b, c = (np.array(R.m[k * n : (k + 1) * n]) for k in range(3))
    block = {
        r + s: R.S[i * n : (i + 1) * n, j * n : (j + 1) * n]
        for (i, r), (j, s) in itertools.product(enumerate("uvw"), repeat=2)
    }
    uu, uv, uw, vu, vv, vw, wv = (block[k] for k in ("uu", "uv", "uw", "vu", "vv", "vw", "wv"))
    for i in range(n):
        expected = (a @ b + trace(uv)) * c[i] + (a @ vw)[i] + (b @ uw)[i]
        assert R.mean_of((u @ v) * w[i]) == expected
    assert R.mean_of((u @ u) * (v @ v)) == (
        (a @ a) * (b @ b)
        + 2 * trace(uv @ vu)
        + trace(uu) * trace(vv)
        + trace(uu) * (b @ b)
        + trace(vv) * (a @ a)
        + 4 * (a @ uv @ b)
    )
    assert R.mean_of((u @ v) * (v @ u)) == (
        (a @ b) ** 2
        + trace(uu @ vv)
        + trace(uv @ uv)
        + trace(uv) ** 2
        + a @ vv @ a
        + b @ uu @ b
        + 2 * (a @ vu @ b)
        + 2 * trace(uv) * (a @ b)
    )
    assert R.mean_of((u @ v) * (w @ u)) == (
        (a @ b) * (c @ a)
        + trace(uv) * trace(uw)
        + trace(uw @ uv)
        + trace(uu @ wv)
        + trace(uw) * (a @ b)
        + trace(uv) * (a @ c)
        + a @ vu @ c
        + a @ vw @ a
        + b @ uu @ c
        + b @ uw @ a
    )


def test_scalar_third_and_fourth_moments():
    n = 4
    s, m = sp.symbols("s0:4"), sp.symbols("m0:4")
    S = sp.Matrix(n, n, lambda i, j: sp.Symbol(f"S{min(i, j)}{max(i, j)}"))
    t = sp.Matrix(s)
    law = sp.exp((t.T * sp.Matrix(m))[0] + (t.T * S * t)[0] / 2)
    zero = dict.fromkeys(s, 0)
    for i, j, k in itertools.combinations_with_replacement(range(n), 3):
        derivative = sp.diff(law, s[i], s[j], s[k]).subs(zero)
        third = m[i] * m[j] * m[k] + m[i] * S[j, k] + m[j] * S[i, k] + m[k] * S[i, j]
        assert sp.expand(derivative - third) == 0
    for index in [(0, 1, 2, 3), (0, 0, 1, 2), (0, 0, 1, 1), (0, 0, 0, 1), (0, 0, 0, 0)]:
        derivative = sp.diff(law, *(s[i] for i in index)).subs(zero)
        fourth = sp.prod([m[i] for i in index])
        for i, j in itertools.combinations(range(4), 2):
            k, l = sorted({0, 1, 2, 3} - {i, j})
            fourth += m[index[i]] * m[index[j]] * S[index[k], index[l]]
            if i == 0:
                fourth += S[index[i], index[j]] * S[index[k], index[l]]
        assert sp.expand(derivative - fourth) == 0


@pytest.mark.parametrize("n", [2, 3])
def test_theorem_2(n):
    # variables: the estimate xhat ~ N(mu, C - P) and the independent error e ~ N(0, P)
    count = n * (n + 1) // 2
    R = Ring(2 * n, [f"{s}{i}" for s in "acp" for i in range(count)])
    A, C, P = (symmetric(R.extra[k * count :], n) for k in range(3))
    law = {}
    for i in range(n):
        law[R.m[n + i]] = 0
        for j in range(i, n):
            law[R.S[i, j]] = C[i, j] - P[i, j]
            law[R.S[n + i, n + j]] = P[i, j]
        for j in range(n):
            law[R.S[i, n + j]] = 0

    def expected(polynomial):
        return R.mean_of(polynomial).compose(list(law.items()))

    xhat, e, mu = np.array(R.x[:n]), np.array(R.x[n:]), np.array(R.m[:n])
    # (P.5): the error of the optimal estimate
    z, zhat = (xhat + e) @ A @ (xhat + e), trace(A @ P) + xhat @ A @ xhat
    gap = e @ A @ e + 2 * (e @ A @ xhat) - trace(A @ P)
    assert z - zhat == gap
    # (P.7)
    ee, ex = e @ A @ e, e @ A @ xhat
    pa = P @ A
    assert expected(ee) == trace(A @ P)
    assert expected(ex) == 0
    assert expected(ee**2) == trace(A @ P) ** 2 + 2 * trace(A @ P @ A @ P)
    assert expected(ex * ee) == 0
    assert expected(ex**2) == trace(pa @ (C - P) @ A) + mu @ A @ P @ A @ mu
    # (3.8), (3.9)
    optimal = 4 * trace(A @ P @ A @ C) - 2 * trace(A @ P @ A @ P) + 4 * (mu @ A @ P @ A @ mu)
    assert expected(gap**2) == optimal
    assert expected((z - xhat @ A @ xhat) ** 2) == optimal + trace(A @ P) ** 2
    # the form without cancellation
    rewritten = 2 * trace(A @ P @ A @ P) + 4 * trace(A @ P @ A @ (C - P))
    assert optimal == rewritten + 4 * (mu @ A @ P @ A @ mu)


def random_case(rng, n, share=1.0):
    root, error = rng.normal(size=(2, n, n))
    P = share * error @ error.T
    return rng.normal(size=n), root @ root.T + P, P


@pytest.mark.parametrize("seed", range(20))
def test_means_of_forms_match_the_fifth_degree_rule(seed):
    rng = np.random.default_rng(seed)
    n = 5
    A, B = rng.normal(size=(2, n, n))
    A2 = rng.normal(size=(3, n))
    mean, _, cov = random_case(rng, n)

    def form(M, x):
        return np.einsum("i...,ij,j...->...", x, M, x)

    size = np.linalg.norm(mean) ** 2 + np.trace(cov)
    for result, f in [
        (linear_mean(A2, mean, cov), lambda x: A2 @ x),
        (quadratic_mean(A, mean, cov), lambda x: form(A, x)),
        (cubic_mean(A2, B, mean, cov), lambda x: (A2 @ x) * form(B, x)),
        (quartic_mean(A, B, mean, cov), lambda x: form(A, x) * form(B, x)),
    ]:
        reference = mean_of(f, mean, cov, fifth_degree(n))
        assert_allclose(result, reference, rtol=0, atol=1e-12 * size**2)


def test_means_of_forms_in_batches():
    rng = np.random.default_rng(1)
    A, B = rng.normal(size=(2, 3, 3))
    means, roots = rng.normal(size=(3, 4)), rng.normal(size=(3, 3, 4))
    covs = np.einsum("ik...,jk...->ij...", roots, roots)
    for function in (
        lambda m, P: quadratic_mean(A, m, P),
        lambda m, P: cubic_mean(A, B, m, P),
        lambda m, P: quartic_mean(A, B, m, P),
    ):
        together, shared = function(means, covs), function(means, covs[..., 0])
        for k in range(4):
            assert_allclose(together[..., k], function(means[:, k], covs[..., k]), rtol=1e-12)
            assert_allclose(shared[..., k], function(means[:, k], covs[..., 0]), rtol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("share", [1.0, 1e-6, 1e-12])
def test_errors_of_forms_match_the_sum_of_squares(n, share):
    rng = np.random.default_rng(n)
    xs = sp.symbols(f"x:{n}")
    X = sp.Matrix(xs)
    A, B = rng.normal(size=(2, n, n))
    A2 = rng.normal(size=(2, n))
    mean, cov, error_cov = random_case(rng, n, share)
    square_a, square_b = ((X.T * sp.Matrix(M) * X)[0] for M in (A, B))
    cases = [
        (square_a, quadratic_errors(A, mean, cov, error_cov)),
        (sp.expand(square_a * square_b), quartic_errors(A, B, mean, cov, error_cov)),
        (sp.Matrix(A2) * X * square_b, cubic_errors(A2, B, mean, cov, error_cov)),
    ]
    for f, result in cases:
        reference = mean_square_errors(f, xs)(mean, cov, error_cov)
        size = np.abs(np.atleast_2d(reference.optimal)).max()
        assert_allclose(result.optimal, reference.optimal, rtol=1e-12, atol=1e-13 * size)
        assert_allclose(result.plugin, reference.plugin, rtol=1e-12, atol=1e-13 * size)


def test_errors_of_scalar_powers():
    m, C, P = 0.7, 1.9, 0.6
    law = ([m], [[C]], [[P]])
    one = [[1.0]]
    square = 2 * P * (2 * C - P + 2 * m**2)
    cube = 3 * P * (9 * C**2 - 6 * C * P + 2 * P**2 + 18 * C * m**2 - 6 * P * m**2 + 3 * m**4)
    fourth = (
        8 * P * (30 * C**3 - 27 * C**2 * P + 12 * C * P**2 - 3 * P**3 + 90 * C**2 * m**2)
    ) + 8 * P * (-54 * C * P * m**2 + 12 * P**2 * m**2 + 30 * C * m**4 - 9 * P * m**4 + 2 * m**6)
    assert_allclose(quadratic_errors(one, *law).optimal, square, rtol=1e-14)
    assert_allclose(cubic_errors(one, one, *law).optimal, [[cube]], rtol=1e-14)
    assert_allclose(quartic_errors(one, one, *law).optimal, fourth, rtol=1e-14)


def test_quadratic_errors_match_simulation():
    rng = np.random.default_rng(8)
    n, draws = 5, 300_000
    A = rng.normal(size=(n, n))
    mean, cov, error_cov = random_case(rng, n)
    xhat = mean[:, None] + np.linalg.cholesky(cov - error_cov) @ rng.normal(size=(n, draws))
    x = xhat + np.linalg.cholesky(error_cov) @ rng.normal(size=(n, draws))
    z, plugin = (np.einsum("ik,ij,jk->k", v, A, v) for v in (x, xhat))
    exact = quadratic_errors(A, mean, cov, error_cov)
    for estimate, error in (
        (plugin + np.sum(A * error_cov), exact.optimal),
        (plugin, exact.plugin),
    ):
        squares = (z - estimate) ** 2
        assert abs(squares.mean() - error) < 4 * squares.std() / np.sqrt(draws)


def test_degenerate_laws():
    A = np.array([[1.0, 2.0], [0.0, 3.0]])
    mean = np.array([0.4, -1.0])
    for cov in (np.eye(2), np.ones((2, 2)), np.zeros((2, 2)), np.diag([2.0, 0.0])):
        zero = np.zeros((2, 2))
        assert quadratic_errors(A, mean, cov, zero) == (0.0, 0.0)
        assert quartic_errors(A, A, mean, cov, zero) == (0.0, 0.0)
        assert not cubic_errors(A, A, mean, cov, zero).plugin.any()
        # without information the optimal error is the prior variance
        second = quartic_mean(A, A, mean, cov) - quadratic_mean(A, mean, cov) ** 2
        assert_allclose(quadratic_errors(A, mean, cov, cov).optimal, second, atol=1e-12)


def test_bad_input_is_refused():
    eye = np.eye(2)
    for call, error in [
        (lambda: quadratic_errors(np.eye(3), [0, 0], eye, eye), ValueError),
        (lambda: quadratic_errors(eye, [0, 0], eye, 2 * eye), ValueError),
        (lambda: quadratic_errors(eye, [0, 0], [[1, 0.5], [0, 1]], eye), ValueError),
        (lambda: quadratic_errors(eye, [0, 0], eye, -eye), ValueError),
        (lambda: quadratic_errors(1j * eye, [0, 0], eye, eye), TypeError),
        (lambda: quadratic_errors(np.array([["a", "b"]] * 2), [0, 0], eye, eye), TypeError),
        (lambda: cubic_mean(np.ones((2, 3)), eye, [0, 0], eye), ValueError),
        (lambda: quartic_mean(eye, eye, [0, np.inf], eye), ValueError),
    ]:
        with pytest.raises(error):
            call()
    with pytest.raises(ValueError, match="exceeds"):
        quartic_errors(eye, eye, [0, 0], eye, np.diag([0.5, 1.1]))
