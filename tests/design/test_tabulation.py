import numpy as np
import pytest

from seedslib import zoo
from seedslib.design import Affine, Continuous, Polynomial, synthesize, tabulated
from seedslib.design.tables.tabulation import output
from seedslib.designed import Memory, finite_memory, large_order, load, save
from seedslib.linearization import Cubature, ExactGaussian, Taylor

TIMES = 0.5 * np.arange(4)
WITH_NODES = np.array([0.0, 0.1, 0.25, 0.5, 0.6, 1.0, 1.5])
MEASURED = np.isin(WITH_NODES, TIMES)


def design(system, memory, rule=None, **options):
    rule = Taylor() if rule is None else rule
    return synthesize(system, memory, rule, TIMES, paths=1000, seed=4, step=0.05, **options)


@pytest.mark.parametrize(
    ("memory", "predictor"),
    [
        (large_order(1), Affine()),
        (large_order(2), Affine()),
        (finite_memory(1), Affine()),
        (Memory(1, 1), Affine()),
        (large_order(1), Continuous()),
    ],
)
@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_table_of_affine_functions_is_exact(memory, predictor):
    """Everything is linear, so multilinear interpolation loses nothing."""
    system = zoo.linear_gaussian()
    made = design(system, memory, predictor=predictor, components=1)
    table = tabulated(made, y=(-40, 40, 5), z=(-30, 30, 4))
    data = system.simulate(WITH_NODES, 40, 1, measured=MEASURED)
    y = data.measurements.copy()
    if not memory.measurements:
        y[3, :, ::2] = np.nan
    one, two = (f.run(WITH_NODES, y).mean for f in (made, table))
    assert np.abs(one).max() < 30
    np.testing.assert_allclose(two, one, rtol=0, atol=1e-11)
    assert table.order == made.order


def test_table_of_a_curved_function_converges_with_the_square_of_its_step():
    system = zoo.flip_process()
    made = design(system, large_order(1), ExactGaussian(), predictor=Polynomial(3, 2))
    data = system.simulate(TIMES, 2000, 2)
    expected = made.run(TIMES, data.measurements).mean
    errors = []
    for fineness in (1, 2, 4):
        table = tabulated(made, y=(-9, 9, 48 * fineness + 1), z=(-5, 5, 48 * fineness + 1))
        apart = table.run(TIMES, data.measurements).mean - expected
        errors.append(np.sqrt((apart**2).mean()))
    assert errors[2] < 2e-3
    assert errors[0] / errors[2] == pytest.approx(16.0, rel=0.35)


@pytest.mark.parametrize("memory", [Memory(2), Memory(1, 1), finite_memory(2)])
def test_output_function_is_what_the_filter_does_step_by_step(memory):
    system = zoo.van_der_pol()
    made = design(system, memory, Cubature())
    y = system.simulate(TIMES, 6, 3).measurements
    state, n = made.initial((6,)), 2
    seen, held = [], []
    for k, t in enumerate(TIMES):
        u = held[::-1][: memory.estimates] + seen[::-1][: memory.measurements]
        u = np.concatenate([*u, np.empty((0, 6))])
        state = made.step(state, t, y[k])
        np.testing.assert_allclose(output(made, k, y[k], u), state.mean, rtol=1e-12)
        seen.append(y[k])
        held.append(state.mean[:n])


def test_covariance_of_the_table_is_the_predicted_error(tmp_path):
    made = design(zoo.flip_process(), large_order(1), ExactGaussian())
    table = tabulated(made, y=(-8, 8, 81), z=(-4, 4, 81))
    data = zoo.flip_process().simulate(TIMES, 20_000, 9)
    found = table.run(TIMES, data.measurements, covariances=True)
    square = ((found.mean - data.states) ** 2).mean(axis=2)[:, 0]
    claimed = found.cov[:, 0, 0]
    # design paths and test paths: standard errors of both
    error = 2 * made.predicted.rms[::5, 0] * made.predicted.error[::5, 0]
    assert (np.abs(square - claimed) < 4 * error).all()
    save(table, tmp_path / "table.npz")
    assert np.array_equal(
        load(tmp_path / "table.npz").run(TIMES, data.measurements).mean, found.mean
    )


@pytest.mark.filterwarnings("ignore:.*records have gaps:UserWarning")
def test_covariance_is_not_claimed_where_the_measurement_is_missing():
    table = tabulated(design(zoo.flip_process(), large_order(1)), y=(-8, 8, 21), z=(-4, 4, 21))
    y = zoo.flip_process().simulate(TIMES, 3, 1).measurements.copy()
    y[1, 0, 1] = np.nan
    found = table.run(TIMES, y, covariances=True).cov
    gone = np.logical_or.accumulate(np.isnan(y[:, 0]), axis=0)
    assert np.isnan(found[:, 0, 0]).tolist() == gone.tolist()
    alone = table.run(TIMES, y[..., 1], covariances=True).cov
    np.testing.assert_array_equal(alone, found[..., 1])


def test_what_has_no_table_is_refused():
    both = design(zoo.linear_gaussian(), large_order(1))
    with pytest.raises(ValueError, match="filter: wanted one estimated component, got 2"):
        tabulated(both, y=(-8, 8, 5), z=[(-8, 8, 5)] * 2)
    one = design(zoo.flip_process(), large_order(1))
    with pytest.raises(ValueError, match="z: wanted 1 axes, got 2"):
        tabulated(one, y=(-8, 8, 5), z=[(-8, 8, 5)] * 2)
    looking = design(zoo.flip_process(), large_order(1), measured_nodes=True)
    with pytest.raises(ValueError, match="filter: wanted forecasts from the memory alone"):
        tabulated(looking, y=(-8, 8, 5), z=(-8, 8, 5))
    with pytest.raises(ValueError, match="k: wanted 0 to 3, got 4"):
        output(one, 4, np.zeros(1), np.zeros(1))
    with pytest.raises(ValueError, match="wanted 1 and 0 components, got 1 and 1"):
        output(one, 0, np.zeros(1), np.zeros(1))
