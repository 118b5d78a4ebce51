"""Re-runs of notebooks compare recorded numbers within their tolerance, the rest to the letter."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads that wait for each other burn time
os.environ.setdefault("PYDEVD_DISABLE_FILE_VALIDATION", "1")

from collections import Counter
from pathlib import PurePosixPath
from unittest.mock import patch

from jupyter_client.provisioning import local_provisioner
from nbval.plugin import IPyNbCell, IPyNbFile

from bookkit import kernels, portable
from bookkit.comparison import deviation, differences, without_records

_compare_to_the_letter = IPyNbCell.compare_outputs
_start_kernel = IPyNbFile.setup


def pytest_addoption(parser):
    parser.addoption("--processor", default="own", help="as which one notebooks are run again")
    parser.addoption("--forked-kernels", action="store_true", help="kernels that start at once")
    parser.addoption("--deviations", help="file to which the deviations of numbers are added")


def _compare_outputs(self, test, ref, skip_compare=None):
    found = differences(ref, test)
    same = _compare_to_the_letter(self, without_records(test), without_records(ref), skip_compare)
    if log := self.config.getoption("--deviations"):
        portable.note(log, self.parent.name, deviation(ref, test))
    if found:
        self.comparison_traceback.extend(found)
    return same and not found


def _setup(self):
    with patch.dict(os.environ, portable.environment(self.config.getoption("--processor"))):
        if self.config.getoption("--forked-kernels"):
            with patch.object(local_provisioner, "launch_kernel", kernels.launch):
                _start_kernel(self)
        else:
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
