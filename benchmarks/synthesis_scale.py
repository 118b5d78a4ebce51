"""Time of a design against the number of paths, on threads and on Dask workers.

Run by hand on an idle machine, ``python benchmarks/synthesis_scale.py``; writes
``benchmarks/synthesis_scale.csv`` beside itself. The ways are interleaved; the figure of each is
its best run, with the processor time of that run over all processes and the load average of the
machine before it, so that a row taken on a busy machine can be recognised: there `seconds` says
little and `cpu_seconds` still something.

The workers get the memory of larger arrays from their heap. By default a Dask worker takes it from
the system and gives it back every time, which costs it a page fault for every 4 KB.
"""

from __future__ import annotations

import csv
import os
import time
from contextlib import ExitStack
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import dask
import numpy as np
from distributed import Client, LocalCluster

from seedslib.linearization import Taylor
from seedslib.memory import Memory
from seedslib.synthesis import synthesize
from seedslib.systems import zoo

PATHS = (20_000, 50_000, 100_000, 200_000, 400_000)
ROUNDS = 2
TACTS = 0.5 * np.arange(7)
KEEP_MEMORY = {
    f"distributed.nanny.pre-spawn-environ.MALLOC_{name}_THRESHOLD_": 2**25
    for name in ("MMAP", "TRIM")
}


def design(paths, **where):
    synthesize(zoo.van_der_pol(), Memory(2), Taylor(), TACTS, nodes=1, paths=paths, seed=1, **where)


def spent(client) -> float:
    """Processor time so far of this process and of the workers, in seconds."""
    there = sum(client.run(time.process_time).values()) if client is not None else 0.0
    return time.process_time() + there


def measured(paths, client, **where):
    """Seconds, processor seconds and load before."""
    load = os.getloadavg()[0]
    before, begin = spent(client), time.perf_counter()
    design(paths, **where)
    seconds = time.perf_counter() - begin
    return seconds, spent(client) - before, load


def main() -> None:
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(KEEP_MEMORY))
        clients = {}
        for workers in (1, 2):
            cluster = LocalCluster(
                n_workers=workers, threads_per_worker=1, dashboard_address=None,
                scheduler_kwargs={"dashboard_address": ":0"}, silence_logs=50,
            )  # fmt: skip
            stack.enter_context(cluster)
            clients[workers] = stack.enter_context(Client(cluster))
        ways = {("threads", w): (None, {"workers": w}) for w in (1, 2)}
        ways |= {("Dask workers", w): (c, {"scheduler": c}) for w, c in clients.items()}
        for client, where in ways.values():
            measured(500, client, **where)  # the first run compiles
        rows = []
        for paths in PATHS:
            found = {way: [] for way in ways}
            for _ in range(ROUNDS):
                for way, (client, where) in ways.items():
                    found[way].append(measured(paths, client, **where))
            base = min(found["threads", 1])[0]
            for way, runs in found.items():
                seconds, cpu, load = min(runs)
                rows.append([
                    paths, *way, f"{seconds:.3f}", f"{cpu:.3f}", f"{base / seconds:.2f}",
                    f"{load:.1f}",
                ])  # fmt: skip
    header = ["paths", "on", "workers", "seconds", "cpu_seconds", "speedup", "load"]
    for row in [header, *rows]:
        print("{!s:>8}  {:14}{!s:>8}{:>10}{:>13}{:>9}{:>6}".format(*row))
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


if __name__ == "__main__":
    main()
