"""``python -m seedslib design --stationary``: filters without an end."""

from seedslib.commands.cli import main

SLOW = """
import sympy as sp
from seedslib.models import JumpDiffusion, Noise

x, v = sp.symbols("x v")
system = JumpDiffusion((x,), [-x / 9], [[1]], [x + v], Noise((v,)), [1], [[3]], step=.5)
"""


def test_a_design_without_an_end(tmp_path, monkeypatch, capsys, write, read, refused):
    monkeypatch.chdir(tmp_path)
    write("slow.py", SLOW)
    design = ["design", "slow.py", "--memory", "estimates=1", "--paths", "4000", "--nodes", "1"]
    grid = ["--times", "0:10:0.5", "--stationary", "0.1", "--out", "f.npz"]
    assert main([*design, *grid]) == 0
    assert "the last step serves all" in capsys.readouterr().out
    rows = (f"{t / 4},{'' if t % 2 else t % 3}\n" for t in range(120))
    write("long.csv", "t,y1\n" + "".join(rows))
    assert main(["filter", "f.npz", "long.csv", "--model", "slow.py", "--out", "x.csv"]) == 0
    names, *rows = read("x.csv")
    assert len(rows) == 120
    assert all(row[names.index("x1")] for row in rows)
    early = [*design, "--times", "0:1.5:0.5", "--stationary", "0.001", "--out", "g.npz"]
    assert "got 0." in refused(capsys, main, *early)
