"""References: means and variances of functions of a Gaussian vector."""

import mpmath as mp

from references.high import (
    Value,
    about,
    below,
    column,
    density,
    family,
    integral,
    matrix,
    moment,
    relative,
)


def larger(mean, cov):
    """Mean and variance of the larger of two normals by their raw moments (Clark)."""
    with mp.workdps(110):
        s = mp.sqrt(cov[0][0] + cov[1][1] - 2 * cov[0][1])
        a, b = mean
        z = (a - b) / s
        first = a * below(z) + b * below(-z) + s * density(z)
        second = (a * a + cov[0][0]) * below(z) + (b * b + cov[1][1]) * below(-z)
        second += (a + b) * s * density(z)
        return first, second - first * first


@family("maximum", "closed form")
def maximum(mean, cov):
    first, var = larger(mean, cov)
    return {"mean": relative(first, mp.sqrt(var)), "var": var}


def modulus_moments(mean, var):
    with mp.workdps(110):
        s = mp.sqrt(var)
        z = mean / s
        first = s * 2 * density(z) + mean * (1 - 2 * below(-z))
        return first, mean * mean + var - first * first


@family("modulus", "closed form")
def modulus(mean, var):
    return dict(zip(("mean", "var"), modulus_moments(mean, var), strict=True))


@family("sine", "closed form")
def sine(mean, var):
    with mp.workdps(140):
        first = mp.exp(-var / 2) * mp.sin(mean)
        return {"mean": first, "var": (1 - mp.exp(-2 * var) * mp.cos(2 * mean)) / 2 - first**2}


def length(mean, cov):
    """E |x| = (1 / sqrt pi) int (1 - E exp(-t² |x|²)) / t² dt, in the axes of the covariance."""
    with mp.workdps(90):
        values, axes = mp.eigsy(matrix(cov))
        turned = axes.T * column(mean)
    floor = mp.mpf(10) ** -60 * max(abs(v) for v in values)
    pairs = [(v if abs(v) > floor else mp.mpf(0), b) for v, b in zip(values, turned, strict=True)]
    reach = mp.sqrt(sum(v + b * b for v, b in pairs))

    def rest(t):
        s = t * t
        logs = sum(mp.log1p(2 * v * s) / 2 + s * b * b / (1 + 2 * v * s) for v, b in pairs)
        return -mp.expm1(-logs) / s

    marks = {1 / (mp.sqrt(v) * k) for v, _ in pairs if v > 0 for k in (4, 1)}
    marks |= {k / reach for k in (mp.mpf(1) / 4, 1, 4)}
    return integral(rest, [0, *marks, mp.inf]) / mp.sqrt(mp.pi)


@family("norm", "quadrature")
def norm(mean, cov):
    centred = length([mp.mpf(0)] * len(mean), cov)
    trace = sum(cov[i][i] for i in range(len(mean)))
    return {"mean": length(mean, cov), "var of error": trace - centred * centred}


@family("polynomial", "exact sum over pairings")
@family("quadrature rules", "exact sum over pairings")
def polynomial(mean, cov, powers, rule=None):
    """True means, which rules of enough degree must give as well."""
    cov, bare = matrix(cov), [abs(m) for m in mean]
    return {
        "".join(f"{s}^{k}" for s, k in zip("xyz", p, strict=False)): relative(
            moment(p, mean, cov), moment(p, bare, cov.apply(abs))
        )
        for p in powers
    }


@family("half space", "quadrature", sensitive=False)
def half_space(mean, cov, normal, offset, powers):
    cov = matrix(cov)
    lean = cov * column(normal)
    centre = sum(c * m for c, m in zip(normal, mean, strict=True)) + offset
    var = sum(c * lean[i] for i, c in enumerate(normal))
    s, rest = mp.sqrt(var), cov - lean * lean.T / var
    depth = s / (1 + abs(centre) / s)
    ends = [mp.mpf(0), centre + mp.sqrt(min(centre, 0) ** 2 + 300 * var)]
    marks = [*about(centre, s), *(depth * k for k in (1, 4, 16, 64))]
    points = [*ends, *(mark for mark in marks if ends[0] < mark < ends[1])]

    def weighed(u, p):
        here = [mean[i] + lean[i] / var * (u - centre) for i in range(2)]
        return density((u - centre) / s) / s * moment(p, here, rest)

    found = {}
    for p in powers:
        found["x^{}y^{}".format(*p)] = integral(lambda u, p=p: weighed(u, p), points)
    return found


@family("exponential", "closed form")
def exponential(mean, cov):
    """With x and y in units of a power of two next to their largest size."""
    size = max(*(abs(m) for m in mean), *(mp.sqrt(cov[i][i]) for i in range(2)))
    size = mp.mpf(2) ** mp.ceil(mp.log(size, 2))
    a, b = (m / size for m in mean)
    p, q, r = (c / size / size for c in (cov[0][0], cov[0][1], cov[1][1]))
    blunt = mp.exp(-r / 2)
    tilt = 1 / (1 + 2 * p)
    bell = mp.sqrt(tilt) * mp.exp(-tilt * a * a)
    return {
        "exp(x/2-y/4)": mp.exp(a / 2 - b / 4 + (p / 4 + r / 16 - q / 4) / 2),
        "x sin y": Value(blunt * (a * mp.sin(b) + q * mp.cos(b)), blunt * (abs(a) + mp.sqrt(p))),
        "cos(x+y)": mp.cos(a + b) * mp.exp(-(p + 2 * q + r) / 2),
        "exp(-x^2)": bell,
        "x exp(-x^2)": Value(a * tilt * bell, bell * (abs(a) + mp.sqrt(p * tilt)) * tilt),
        "erf(x)": relative(mp.erf(a * mp.sqrt(tilt)), mp.sqrt(p)),
    }


def axial(mean, across, along):
    """Density of the elevation of N((0, 0, mean), diag(across, across, along))."""

    def f(angle):
        c, s = mp.cos(angle), mp.sin(angle)
        a, b = c * c / across + s * s / along, mean * s / along
        inner = mp.exp(b * b / (2 * a) - mean * mean / (2 * along)) * below(b / mp.sqrt(a))
        inner *= mp.sqrt(2 * mp.pi / a) * (b * b / a + 1) / a
        inner += b / a / a * mp.exp(-mean * mean / (2 * along))
        return c * inner / (across * mp.sqrt(2 * mp.pi * along))

    return f


def planar(mean, cov):
    """Density of the polar angle of a Gaussian vector in the plane."""
    inverse = matrix(cov) ** -1
    determinant = cov[0][0] * cov[1][1] - cov[0][1] * cov[1][0]
    whole = (column(mean).T * inverse * column(mean))[0]

    def f(angle):
        e = column([mp.cos(angle), mp.sin(angle)])
        a, b = (e.T * inverse * e)[0], (e.T * inverse * column(mean))[0]
        inner = mp.exp(-whole / 2) / a
        bump = mp.sqrt(2 * mp.pi) * b / a / mp.sqrt(a) * below(b / mp.sqrt(a))
        return (inner + bump * mp.exp((b * b / a - whole) / 2)) / (2 * mp.pi * mp.sqrt(determinant))

    return f


@family("elevation", "quadrature")
def elevation(mean, across=None, along=None, cov=None):
    half = mp.pi / 2
    if cov is None:
        f, marks = axial(mean[2], across, along), [-half, 0, half]
        width = mp.sqrt(across) / (abs(mean[2]) + mp.sqrt(across))
        marks += [sign * (half - width * k) for k in (1, 3, 9) for sign in (-1, 1)]
        marks = [mark for mark in marks if abs(mark) <= half]
    else:
        f = planar([mean[0], mean[2]], cov)
        centre = mp.atan2(mean[2], mean[0])
        width = mp.sqrt(cov[0][0] + cov[1][1]) / mp.hypot(mean[0], mean[2])
        marks = [-half, half, 3 * half, centre]
        marks += [centre + sign * width * k for k in (1, 4, 16) for sign in (-1, 1)]
        marks = [mark for mark in marks if -half <= mark <= 3 * half]

    def folded(angle):
        return angle if angle <= half else mp.pi - angle

    first = integral(lambda t: folded(t) * f(t), marks)
    var = integral(lambda t: (folded(t) - first) ** 2 * f(t), marks)
    return {"mean": relative(first, mp.sqrt(var)), "var": var}
