"""References: linear motion in continuous time, the Kalman-Bucy filter, what stands on it."""

import mpmath as mp

from references.errors import maximum_error, modulus_error, polynomial_error, sine_error
from references.filters import corrected
from references.high import Value, column, dist_values, family, matrix
from references.record import wave


def matrix_dist(found, name):
    """Entries, relative to the largest of the matrix."""
    scale = max(abs(found[i, j]) for i in range(found.rows) for j in range(found.cols))
    return {
        f"{name} {i}{j}": Value(found[i, j], scale)
        for i in range(found.rows)
        for j in range(found.cols)
    }


def moved(drift, diffusion, step):
    """Transition and noise of a step, from the exponential of a matrix of twice the size."""
    n = drift.rows
    block = mp.zeros(2 * n)
    block[:n, :n], block[:n, n:], block[n:, n:] = -drift, diffusion, drift.T
    power = mp.expm(block * step, method="taylor")
    move = power[n:, n:].T
    return move, move * power[:n, n:]


def digits(drift, time):
    """Enough for the growth that cancels in such an exponential."""
    return 100 + int(time * sum(abs(drift[i, j]) for i in range(2) for j in range(2)))


@family("discretisation", "series")
def discretisation(drift, diffusion, step):
    drift, diffusion = matrix(drift), matrix(diffusion)
    with mp.workdps(digits(drift, step)):
        move, noise = moved(drift, diffusion, step)
        root = [mp.sqrt(noise[i, i]) for i in range(2)]
        spread = {
            f"noise {i}{j}": Value(noise[i, j], root[i] * root[j])
            for i in range(2)
            for j in range(i + 1)
        }
        return {**matrix_dist(move, "transition"), **spread}


def hamiltonian(drift, diffusion, sensor, intensity):
    n = drift.rows
    block = mp.zeros(2 * n)
    block[:n, :n], block[n:, n:] = -drift.T, drift
    block[:n, n:], block[n:, :n] = sensor.T * intensity**-1 * sensor, diffusion
    return block


@family("Riccati equation", "invariant subspace")
def riccati(drift, diffusion, sensor, intensity):
    """The steady covariance from the growing eigenvectors of the Hamiltonian matrix."""
    with mp.workdps(90):
        block = hamiltonian(*map(matrix, (drift, diffusion, sensor, intensity)))
        values, vectors = mp.eig(block)
        kept = [k for k in range(4) if mp.re(values[k]) > 0]
        assert len(kept) == 2
        upper, bottom = mp.zeros(2), mp.zeros(2)
        for j, k in enumerate(kept):
            upper[:, j], bottom[:, j] = vectors[:2, k], vectors[2:, k]
        cov = (bottom * upper**-1).apply(mp.re)
        return {k: v for k, v in dist_values(column([1, 1]), cov).items() if k.startswith("cov")}


@family("Kalman-Bucy filter", "series")
def kalman_bucy(drift, diffusion, sensor, intensity, mean0, cov0, step):
    """Mean x - P p and covariance V U⁻¹ from the linear flows of (p, x) and (U, V)."""
    with mp.workdps(140):
        drift, diffusion, sensor, intensity = map(matrix, (drift, diffusion, sensor, intensity))
        block = hamiltonian(drift, diffusion, sensor, intensity)
        whole = mp.zeros(6)
        whole[:4, :4], whole[:4, 4:] = block, mp.eye(4)[:, :2]
        power = mp.expm(whole * step, method="taylor")
        move, push = power[:4, :4], power[:4, 4:]
        mean, cov = column(mean0), matrix(cov0)
        for k in range(50):
            rate = column([mp.mpf(wave(k, j)) / 16 for j in range(sensor.rows)])
            lean = -sensor.T * intensity**-1 * rate
            start = mp.zeros(4, 3)
            start[:2, :2], start[2:, :2], start[2:, 2] = mp.eye(2), cov, mean
            flow = move * start
            flow[:, 2] += push * lean
            cov = flow[2:, :2] * flow[:2, :2] ** -1
            mean = flow[2:, 2] - cov * flow[:2, 2]
        return dist_values(mean, cov)


@family("two-step estimator", "quadrature", sensitive=False)
def two_step(mean0, cov0, drift, diffusion, sensor, intensity, time):
    """Errors of estimates of a product, a sine, a modulus and a maximum at one time."""
    drift, diffusion, sensor, intensity = map(matrix, (drift, diffusion, sensor, intensity))
    with mp.workdps(300):  # the flow grows by up to a hundred digits
        move, noise = moved(drift, diffusion, time)
        cov, mean = move * matrix(cov0) * move.T + noise, move * column(mean0)
        power = mp.expm(hamiltonian(drift, diffusion, sensor, intensity) * time, method="taylor")
        start = mp.zeros(4, 2)
        start[:2, :], start[2:, :] = mp.eye(2), matrix(cov0)
        flow = power * start
        error = flow[2:, :] * flow[:2, :] ** -1
    error = (error + error.T) / 2
    dist = list(mean), cov.tolist(), error.tolist()
    scalar = mean[0], cov[0, 0], error[0, 0]
    product = polynomial_error(*dist, powers=[[1, 1]])
    found = {
        "product": {name: product[f"{name} x^1y^1"] for name in ("optimal", "plugin")},
        "sine": sine_error(*scalar),
        "modulus": modulus_error(*scalar),
        "maximum": maximum_error(*dist),
    }
    return {f"{f} {name}": v for f, told in found.items() for name, v in told.items()}


@family("designed filter", "recursion")
def designed(mean0, cov0, drift, diffusion, sensor, step, noise, memory):
    """Estimate from the last measurements; of all of them where an estimate is remembered.

    A memory of -l is that of l measurements beside the present one, 1 that of an estimate.
    """
    with mp.workdps(120):
        steps, row = 12, matrix(sensor)
        move, spread = moved(matrix(drift), matrix(diffusion), step)
        means, covs = [column(mean0)], [matrix(cov0)]
        for _ in range(steps):
            means.append(move * means[-1])
            covs.append(move * covs[-1] * move.T + spread)
        first = 0 if memory > 0 else steps + memory
        used = range(first, steps + 1)
        inner, error = mp.zeros(len(used)), mp.zeros(len(used), 1)
        cross = mp.zeros(2, len(used))
        for a, i in enumerate(used):
            error[a] = mp.mpf(wave(i)) / 16 - (row * means[i])[0]
            cross[:, a] = move ** (steps - i) * covs[i] * row.T
            for b, j in enumerate(used):
                late, soon = max(i, j), min(i, j)
                inner[a, b] = (row * move ** (late - soon) * covs[soon] * row.T)[0]
            inner[a, a] += noise
        mean, cov, _ = corrected(means[-1], covs[-1], error, cross, inner)
        return dist_values(mean, cov)
