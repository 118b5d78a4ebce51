import numpy as np
import pytest

from seedslib.filters import Estimates, RaoBlackwellFilter, extended_kalman
from seedslib.models import LinearSystem
from seedslib.zoo import manoeuvring_target

TIMES = np.arange(30.0)


@pytest.fixture(scope="module")
def run():
    system = LinearSystem([[0.9, 0.1], [0.0, 0.8]], np.eye(2), [[1, 0]], 0.5, [0, 0], np.eye(2))
    sim = system.simulate(TIMES, 400, 0)
    return np.asarray(sim.states), extended_kalman(system).run(TIMES, sim.measurements)


def test_intervals_cover_what_they_say(run):
    states, found = run
    low, high = found.interval(0.9)
    inside = ((low < states) & (states < high)).mean()
    assert abs(inside - 0.9) < 4 * np.sqrt(0.09 / 400)  # times of one path depend on each other


@pytest.mark.parametrize("level", [0.0, 1.0, 95])
def test_a_level_is_a_probability(run, level):
    with pytest.raises(ValueError, match="level: wanted a number between 0 and 1"):
        run[1].interval(level)


def test_without_covariances_there_are_no_intervals():
    with pytest.raises(ValueError, match="wanted covariances"):
        Estimates(np.zeros((3, 1))).interval()


def test_a_table_of_many_records(run):
    table = run[1].to_dataframe(TIMES, ["place", "speed"])
    assert list(table.columns) == ["place", "speed", "place_sd", "speed_sd", "loglik"]
    row = table.loc[(7.0, 123)]
    assert row["speed"] == run[1].mean[7, 1, 123]
    assert row["place_sd"] == pytest.approx(np.sqrt(run[1].cov[7, 0, 0]))
    assert table["loglik"].sum() == pytest.approx(run[1].loglik.sum())


def test_a_table_of_one_record_is_indexed_by_time(run):
    one = Estimates(run[1].mean[..., 0], run[1].cov)
    table = one.to_dataframe(TIMES)
    assert table.index.name == "t"
    assert table.loc[3.0, "x2"] == run[1].mean[3, 1, 0]


def test_what_does_not_fit_is_refused(run):
    with pytest.raises(ValueError, match="times: wanted 30, got 2"):
        run[1].to_dataframe([0, 1])
    with pytest.raises(ValueError, match="names: wanted 2, got 1"):
        run[1].to_dataframe(TIMES, ["x"])


def test_a_data_set_has_named_axes(run):
    data = run[1].to_xarray(TIMES, ["place", "speed"])
    assert data["mean"].dims == ("t", "component", "batch0")
    part = data["mean"].sel(t=7.0, component="speed")[123]
    assert float(part) == run[1].mean[7, 1, 123]
    assert data["cov"].sel(t=7.0, component="place", other="speed").ndim == run[1].cov.ndim - 3
    assert data["diverged"].dims == ("batch0",)


def test_switching_filters_give_their_modes():
    system = manoeuvring_target()
    sim = system.simulate(TIMES, 3, 0)
    found = RaoBlackwellFilter(system, 20).run(TIMES, sim.measurements, indicators=sim.indicators)
    table, data = found.to_dataframe(TIMES), found.to_xarray(TIMES)
    assert table.loc[(4.0, 2), "mode"] == found.modes[4, 2]
    assert table.loc[(4.0, 2), "mode1"] == found.mode_prob[4, 1, 2]
    assert data["modes"].dims == ("t", "batch0")
