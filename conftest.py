"""Re-runs of notebooks compare recorded numbers within their tolerance, the rest to the letter."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads that wait for each other burn time
os.environ.setdefault("PYDEVD_DISABLE_FILE_VALIDATION", "1")

from collections import Counter
from pathlib import PurePosixPath
from unittest.mock import patch

from nbval.plugin import IPyNbCell, IPyNbFile

from bookkit.comparison import differences, without_records
from bookkit.processor import environment

_compare_to_the_letter = IPyNbCell.compare_outputs
_start_kernel = IPyNbFile.setup


def pytest_addoption(parser):
    parser.addoption("--processor", default="own", help="as which one notebooks are run again")


def _compare_outputs(self, test, ref, skip_compare=None):
    errors = differences(ref, test)
    same = _compare_to_the_letter(self, without_records(test), without_records(ref), skip_compare)
    if errors:
        self.comparison_traceback.extend(errors)
    return same and not errors


def _setup(self):
    with patch.dict(os.environ, environment(self.config.getoption("--processor"))):
        _start_kernel(self)


def _subject(nodeid):
    """The folder of a test (or its file, above the folders), or the paper of a notebook."""
    folder, *inner = PurePosixPath(nodeid.partition("::")[0]).parts
    if folder == "notebooks":
        return f"notebooks/{inner[0].partition('_')[0]}_*"
    return "/".join((folder, *inner[:1]))


def pytest_terminal_summary(terminalreporter):
    """Seconds by package, the slowest first, so that a slow one is seen when it comes."""
    seconds = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            if hasattr(report, "duration"):
                seconds[_subject(report.nodeid)] += report.duration
    terminalreporter.section("seconds by package")
    for subject, total in seconds.most_common():
        terminalreporter.line(f"{total:7.1f}  {subject}")


IPyNbCell.compare_outputs = _compare_outputs
IPyNbFile.setup = _setup
