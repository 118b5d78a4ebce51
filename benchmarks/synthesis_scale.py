"""Time of a design against the number of paths, on threads and on Dask workers.

Run by hand on an idle machine, ``python benchmarks/synthesis_scale.py``; writes
``benchmarks/synthesis_scale.csv`` beside itself. The ways are interleaved; the figures of each are
medians over its runs: seconds, processor time over all processes, and how many times as fast it is
as one thread or one worker in the same round. With them stands the load average of the machine
before, so that a row taken on a busy machine can be recognised: there `seconds` says little and
`cpu_seconds` still something. The cluster is started after the threads are done.
"""

from __future__ import annotations

import csv
import os
import time
from contextlib import ExitStack
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from distributed import Client, LocalCluster

from seedslib import zoo
from seedslib.design import synthesize
from seedslib.designed import Memory
from seedslib.extra import cluster
from seedslib.linearization import Taylor

PATHS = (20_000, 50_000, 100_000, 200_000, 400_000, 800_000)
THREAD_ROUNDS, CLUSTER_ROUNDS = 15, 3
TACTS = 0.5 * np.arange(7)


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


def rows_of(name, ways, rounds):
    """A row for each number of paths and each way, from interleaved runs."""
    for client, where in ways.values():
        measured(500, client, **where)  # the first run compiles
    for paths in PATHS:
        runs = np.array(
            [
                [measured(paths, client, **where) for client, where in ways.values()]
                for _ in range(rounds)
            ]
        )
        gains = runs[:, :1, 0] / runs[:, :, 0]
        for k, workers in enumerate(ways):
            seconds, cpu, load = np.median(runs[:, k], axis=0)
            gain = np.median(gains[:, k])
            yield [
                paths,
                name,
                workers,
                f"{seconds:.3f}",
                f"{cpu:.3f}",
                f"{gain:.2f}",
                f"{load:.1f}",
            ]


def main() -> None:
    rows = list(rows_of("threads", {w: (None, {"workers": w}) for w in (1, 2)}, THREAD_ROUNDS))
    with ExitStack() as stack:
        ways = {}
        for workers in (1, 2):
            local = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                dashboard_address=None,
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
                silence_logs=50,
            )
            stack.enter_context(local)
            client = stack.enter_context(Client(local))
            executor = stack.enter_context(cluster(client))
            ways[workers] = client, {"workers": executor}
        rows += rows_of("Dask workers", ways, CLUSTER_ROUNDS)
    rows.sort(key=lambda row: row[0])
    header = ["paths", "on", "workers", "seconds", "cpu_seconds", "speedup", "load"]
    for row in [header, *rows]:
        print("{!s:>8}  {:14}{!s:>8}{:>10}{:>13}{:>9}{:>6}".format(*row))
    with Path(__file__).with_suffix(".csv").open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


if __name__ == "__main__":
    main()
