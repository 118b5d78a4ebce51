"""What a notebook may take while it runs: time, memory, and room for what it shows.

A kernel that takes more is killed, and what ran it says why; its process takes its kernel with it
when it loses its parent.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from typing import Any, NamedTuple

from nbclient import NotebookClient
from nbclient.exceptions import DeadKernelError

_MESSAGE = 100  # bytes that a message takes beside what it shows


class Limits(NamedTuple):
    """Of one run of a notebook.

    Attributes
    ----------
    seconds : float
        For all of it.
    memory : float
        Gigabytes of data of its kernel, and of each process that this starts; on Linux only.
    shown : int
        Megabytes of text and pictures.
    """

    seconds: float = 3600.0
    memory: float = 4.0
    shown: float = 50.0

    def check(self) -> None:
        """Refuse what limits nothing.

        Raises
        ------
        ValueError
            Which.
        """
        for name, value in self._asdict().items():
            if not 0 < value < float("inf"):
                raise ValueError(f"{name}: wanted a positive number, got {value!r}")


class Over(RuntimeError):
    """What a notebook took too much of, a sentence."""


class Held(NotebookClient):
    """A client of notebooks that keeps to limits.

    Parameters
    ----------
    *args, **options
        As `NotebookClient`.
    limits : Limits
    """

    def __init__(self, *args: Any, limits: Limits, **options: Any) -> None:
        super().__init__(*args, on_notebook_start=self._begin, **options)
        self._limits, self._over, self._shown = limits, "", 0
        self._timer = threading.Timer(limits.seconds, self._give_up, [_longer(limits)])
        self._timer.daemon = True

    def execute(self, **options: Any) -> Any:
        """Execute the notebook.

        Raises
        ------
        Over
            It took more than it may.
        """
        _RUNNING.add(self)
        try:
            return super().execute(**options)
        except DeadKernelError:
            if self._over:
                raise Over(self._over) from None
            raise
        finally:
            _RUNNING.discard(self)
            self._timer.cancel()

    def process_message(self, msg: dict[str, Any], *args: Any) -> Any:
        """Take a message of the kernel in, unless there were too many."""
        content = msg["content"]
        parts = [content.get("text", ""), *content.get("data", {}).values()]
        self._shown += _MESSAGE + sum(len(part) for part in parts if isinstance(part, str))
        if self._shown > 1e6 * self._limits.shown:
            self._give_up(f"showed more than {self._limits.shown:g} MB")
        return None if self._over else super().process_message(msg, *args)

    def _begin(self, notebook: Any) -> None:
        self._timer.start()
        with contextlib.suppress(ImportError, AttributeError, ProcessLookupError):
            import resource  # there is none on Windows, and no prlimit on macOS

            size = int(1e9 * self._limits.memory)
            resource.prlimit(self._kernel().pid, resource.RLIMIT_DATA, (size, size))

    def _kernel(self) -> Any:
        return self.km.provisioner.process

    def _give_up(self, why: str) -> None:
        """Kill the kernel with all that it has started."""
        self._over = self._over or why
        with contextlib.suppress(AttributeError, ProcessLookupError):  # it may just have ended
            process = self._kernel()
            if hasattr(os, "killpg"):
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()


_RUNNING: set[Held] = set()


def end_with_parent() -> None:
    """Let this process, which another has started, end with it, and its kernels too."""

    def watch() -> None:
        parent.join()
        for client in list(_RUNNING):
            client._give_up("the process that wanted it has ended")
        os._exit(1)

    if (parent := multiprocessing.parent_process()) is not None:
        threading.Thread(target=watch, daemon=True).start()


def _longer(limits: Limits) -> str:
    return f"took longer than {limits.seconds:g} s"
