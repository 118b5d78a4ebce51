"""Kernels that are forked: each as fresh as one that was started, and gone when it is to be."""

import json
import os
import signal
import time
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import pytest
from jupyter_client.manager import start_new_kernel
from jupyter_client.provisioning import local_provisioner

from bookkit import kernels

STATE = """
import json, os, sys
state = {
    "argv": sys.argv[:-1], "path": sys.path, "folder": os.getcwd(), "name": __name__,
    "names": sorted(name for name in dir() if not name.startswith("_")),
    "ours": sorted(name for name in sys.modules if name.startswith(("seedslib", "bookkit"))),
    "environment": {k: v for k, v in os.environ.items() if k != "JPY_PARENT_PID"},
    "group": os.getpgid(0) == os.getpid(),
}
import matplotlib
print(json.dumps(state | {"backend": matplotlib.rcParams["backend"]}))
"""


@contextmanager
def kernel(forked=True, **options):
    launch = kernels.launch if forked else local_provisioner.launch_kernel
    with patch.object(local_provisioner, "launch_kernel", launch):
        manager, client = start_new_kernel(kernel_name="python3", **options)
    try:
        yield manager, client
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)


def said(client, code):
    """What a cell prints or returns."""
    found = []

    def kept(message):
        content = message["content"]
        found.append(content.get("text", "") + content.get("data", {}).get("text/plain", ""))

    reply = client.execute_interactive(code, timeout=60, output_hook=kept)
    assert reply["content"]["status"] == "ok", reply["content"]
    return "".join(found)


def test_a_forked_kernel_begins_as_one_that_was_started(tmp_path):
    with kernel(False, cwd=str(tmp_path)) as (_, client):
        wanted = json.loads(said(client, STATE))
    with kernel(cwd=str(tmp_path)) as (_, client):
        found = json.loads(said(client, STATE))
        figure = said(client, "import matplotlib.pyplot as plt\nplt.plot([1, 2]);")
    assert found == wanted
    assert found["ours"] == []
    assert found["folder"] == str(tmp_path)
    assert "Figure size" in figure


def test_two_kernels_share_nothing():
    change = "import os, numpy\nnumpy.mine, name = 1, 2\nos.environ['MINE'] = '1'\nos.getpid()"
    look = "import os, numpy\nprint(os.getpid(), hasattr(numpy, 'mine'), 'MINE' in os.environ)"
    with kernel() as (_, one), kernel() as (_, two):
        first = said(one, change)
        second, *shared = said(two, look + "\nprint('name' in dir())").split()
    assert first != second
    assert shared == ["False"] * 3


def test_the_end_of_a_kernel_is_known_by_its_code():
    with kernel() as (manager, client):
        process = manager.provisioner.process
        assert process.poll() is None
        client.execute("import os; os._exit(3)")
        assert process.wait() == process.poll() == 3
        process.send_signal(signal.SIGKILL)  # nobody: its number may be another's by now
    with kernel() as (manager, _):
        process = manager.provisioner.process
        process.kill()
        assert process.wait() == -signal.SIGKILL


def gone(pid):
    state = Path(f"/proc/{pid}/stat")
    return not state.exists() or state.read_text().rpartition(")")[2].split()[0] == "Z"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="the processes of Linux")
def test_kernels_end_with_the_process_that_wanted_them(tmp_path):
    empty = ("numpy/random", "matplotlib/pyplot", "scipy/integrate", "scipy/optimize",
             "scipy/stats", "sympy/core")  # fmt: skip
    for path in (tmp_path / name for name in empty):
        path.parent.mkdir(exist_ok=True)
        path.with_name("__init__.py").touch()
        path.with_suffix(".py").touch()
    paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    with kernel(env=os.environ | {"PYTHONPATH": paths}) as (manager, client):
        process = manager.provisioner.process
        assert said(client, "import numpy\nprint(hasattr(numpy, 'array'))") == "False\n"
        kernels._end(process._parent)
        deadline = time.monotonic() + 30
        while not gone(process.pid):
            assert time.monotonic() < deadline
            time.sleep(0.1)
        with pytest.raises(RuntimeError, match="the process from which kernels are forked has"):
            process.poll()
        process.returncode = 0
