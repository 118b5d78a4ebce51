"""Re-runs of notebooks compare recorded numbers within their tolerance, the rest to the letter."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("PYDEVD_DISABLE_FILE_VALIDATION", "1")

from nbval.plugin import IPyNbCell

from bookkit.comparison import differences, without_records

_compare_to_the_letter = IPyNbCell.compare_outputs


def _compare_outputs(self, test, ref, skip_compare=None):
    found = differences(ref, test)
    same = _compare_to_the_letter(self, without_records(test), without_records(ref), skip_compare)
    if found:
        self.comparison_traceback.extend(found)
    return same and not found


IPyNbCell.compare_outputs = _compare_outputs
