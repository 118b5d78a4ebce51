import copy

import nbformat
import pytest

from bookkit import run_sweep
from bookkit.grids import check_points, read_grid

GRID = "grid:\n  gain: [1.0, 3.0]\n  count: [2, 3]\n"


@pytest.fixture
def grid(project):
    path = project / "grid.yaml"
    path.write_text(GRID)
    return path


def notebook(project):
    return project / "notebooks" / "tiny.ipynb"


@pytest.fixture
def content(project):
    return nbformat.read(notebook(project), as_version=4)


def test_the_grid_is_a_full_product_with_the_first_name_slowest(grid):
    assert [tuple(p.values()) for p in read_grid(grid).points()] == [
        (1.0, 2),
        (1.0, 3),
        (3.0, 2),
        (3.0, 3),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("grid: {gian: [1.0]}", "gian: unknown parameter, the notebook has gain, count"),
        ("grid: {gain: [1.0, 'two', -3.0]}", "gain = 'two'.*gain = -3.0"),
        ("grid: {count: [1.5]}", "count = 1.5"),
        ("grid: {gain: []}", "grid.gain"),
        ("grid: {}", "grid"),
        ("grad: {gain: [1.0]}", "grad"),
        ("grid: [", "not YAML"),
        ("grid: {gain: [1.0], gain: [2.0]}", "'gain' stands twice"),
        ("grid: {gain: [.nan]}", "gain = nan: input should be a finite number"),
        ("grid: {gain: [.inf]}", "gain = inf: input should be a finite number"),
        ("grid: {gain: [true]}", "gain = True"),
        ("grid: {gain: [[1.0, 2.0]]}", r"gain = \[1\.0, 2\.0\]"),
        ("grid: {1: [2.0]}", "grid.1"),
        ("[1, 2]", "valid dictionary"),
        ("", "valid dictionary"),
    ],
)
def test_a_bad_grid_is_refused_before_anything_runs(project, grid, text, message):
    grid.write_text(text)
    with pytest.raises(ValueError, match=message):
        run_sweep(notebook(project), grid, project / "out", quiet=True)
    assert not (project / "out").exists()


@pytest.mark.parametrize("value", ["null", "2020-01-01", "[[1]]", "{a: 1}"])
def test_a_value_of_no_known_kind_is_named_once(grid, value):
    grid.write_text(f"grid: {{gain: [1.0, {value}]}}")
    with pytest.raises(ValueError, match=r"grid\.gain\.1 = .*wanted a number, a string") as caught:
        read_grid(grid)
    assert ";" not in str(caught.value)


def test_a_file_that_is_no_text_is_named(grid):
    grid.write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match=r"grid\.yaml: not a text file"):
        read_grid(grid)
    with pytest.raises(ValueError, match="no such grid file"):
        read_grid(grid.parent)


def test_the_check_is_found_behind_a_text_cell(content):
    content.cells.insert(2, nbformat.v4.new_markdown_cell("# A heading"))
    check_points(content, [{"gain": 1.0}])
    with pytest.raises(ValueError, match=r"gain = -1\.0"):
        check_points(content, [{"gain": -1.0}])


def test_without_a_check_after_the_parameters_nothing_is_run(content):
    other = copy.deepcopy(content)
    other.cells.insert(2, nbformat.v4.new_code_cell("x = 1"))
    del content.cells[2:]
    for one in (content, other):
        with pytest.raises(ValueError, match="no check cell after its parameters"):
            check_points(one, [{"gain": -1.0}])


def test_a_parameter_that_the_check_leaves_out_cannot_be_swept(content):
    content.cells[2].source = content.cells[2].source.replace(", count=integer(ge=1, le=5)", "")
    check_points(content, [{"gain": 1.0}])
    with pytest.raises(ValueError, match="count: the notebook's check cell does not check it"):
        check_points(content, [{"count": "many"}])


@pytest.mark.parametrize("line", ["%matplotlib inline", "gain = undefined"])
def test_a_parameters_cell_that_does_not_run_is_named(content, line):
    content.cells[1].source = f"{line}\ngain: float = 2.0\ncount: int = 3"
    with pytest.raises(ValueError, match=r"parameters cell does not run: (Syntax|Name)Error"):
        check_points(content, [{"gain": 1.0}])


def test_what_the_parameters_cell_imports_is_no_parameter(content):
    content.cells[1].source = "import math\n\ngain: float = math.pi  # x\ncount: int = 3"
    with pytest.raises(ValueError, match="math: unknown parameter, the notebook has gain, count"):
        check_points(content, [{"math": 1}])


def test_many_bad_points_make_a_short_message(content):
    points = [{"gain": -float(i), "count": j} for i in range(20) for j in range(6, 20)]
    with pytest.raises(ValueError, match="and 270 more") as caught:
        check_points(content, points)
    assert len(str(caught.value)) < 2000


def test_a_notebook_without_parameters_is_refused():
    bare = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1 + 1")])
    with pytest.raises(ValueError, match="no cell tagged"):
        check_points(bare, [{"a": 1.0}])
