"""Kernels forked from one process that has imported what notebooks import.

A kernel takes three seconds to import itself, NumPy, SciPy, SymPy and Matplotlib, longer than
many a notebook runs. Where many notebooks are run again, one process imports them and the
kernels are its children: each has a state of its own, and nothing of the library or of this
package is imported before its notebook does it. The process runs this file as a program.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

_IMPORTED = (
    "ipykernel_launcher",
    "ipykernel.kernelapp",
    "IPython.core.completerlib",
    "IPython.extensions.storemagic",
    "matplotlib.pyplot",
    "numpy.random",
    "pydantic",
    "scipy.integrate",
    "scipy.optimize",
    "scipy.stats",
    "sympy",
    "yaml",
)
_INLINE = "module://matplotlib_inline.backend_inline"  # what a kernel sets before it imports


class Child:
    """A forked kernel, with what Jupyter asks of a process that it has started itself."""

    stdin = stdout = stderr = None

    def __init__(self, parent: subprocess.Popen[str], pid: int) -> None:
        self._parent, self.pid = parent, pid
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Exit code, or None while it runs."""
        if self.returncode is None:
            self.returncode = _ask(self._parent, poll=self.pid)
        return self.returncode

    def wait(self) -> int:
        """Exit code, when it has ended."""
        while (code := self.poll()) is None:
            time.sleep(0.02)
        return code

    def send_signal(self, number: int) -> None:
        """Send it a signal if it still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it."""
        self.send_signal(signal.SIGKILL)


def launch(cmd: Sequence[str], *, env: Mapping[str, str], cwd: str = ".", **_: Any) -> Child:
    """Fork a kernel, in place of `jupyter_client.launcher.launch_kernel`.

    Parameters
    ----------
    cmd : sequence of str
        Command line ``python -m ipykernel_launcher ...``.
    env : mapping of str
        Environment of the kernel. There is a process to fork from for each that differs in more
        than the name of the running test.
    cwd : str
        Folder to run in.
    """
    lasting = ((name, text) for name, text in env.items() if name != "PYTEST_CURRENT_TEST")
    parent = _parent(tuple(sorted(lasting)))
    order = {"arguments": list(cmd[2:]), "environment": dict(env), "folder": os.path.abspath(cwd)}
    return Child(parent, _ask(parent, **order))


@cache
def _parent(environment: tuple[tuple[str, str], ...]) -> subprocess.Popen[str]:
    """The process to fork from; it ends when this one does, with its input."""
    made = subprocess.Popen(
        [sys.executable, __file__],
        env={"MPLBACKEND": _INLINE} | dict(environment),
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    atexit.register(_end, made)
    return made


def _end(parent: subprocess.Popen[str]) -> None:
    assert parent.stdin is not None
    parent.stdin.close()
    parent.wait()


def _ask(parent: subprocess.Popen[str], **order: Any) -> Any:
    assert parent.stdin is not None
    assert parent.stdout is not None
    try:
        parent.stdin.write(json.dumps(order) + "\n")
        parent.stdin.flush()
        return json.loads(parent.stdout.readline())
    except (OSError, ValueError):
        raise RuntimeError("the process from which kernels are forked has ended") from None


def _serve() -> dict[str, Any]:
    """Fork and watch children as told line by line; returns in a child, with what it is to be."""
    for line in sys.stdin:
        order = json.loads(line)
        if "poll" in order:
            pid, status = os.waitpid(order["poll"], os.WNOHANG)
            answer = os.waitstatus_to_exitcode(status) if pid else None
        elif answer := os.fork():
            os.setpgid(answer, answer)  # before it is known: signals go to the whole group
        else:
            return order
        print(json.dumps(answer), flush=True)
    sys.exit()


def _become(order: Mapping[str, Any]) -> None:
    """Run a kernel as if this process had just been started for it."""
    from ipykernel import kernelapp

    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    os.environ.clear()
    os.environ.update(order["environment"], JPY_PARENT_PID=str(os.getppid()))
    os.chdir(order["folder"])
    sys.argv = [str(sys.modules["ipykernel_launcher"].__file__), *order["arguments"][1:]]
    # when the module was imported it read the number of another parent
    kernelapp.launch_new_instance(parent_handle=os.getppid())


if __name__ == "__main__":
    del sys.path[0]  # the folder of this file
    for name in _IMPORTED:
        importlib.import_module(name)
    gc.freeze()  # kernels need not look through what is here, least of all when they end
    _become(_serve())
