"""The README's Python example runs as printed."""

import re
from pathlib import Path

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.simulation.simulator import SimulationConfig

README = Path(__file__).resolve().parents[1] / "README.md"


def test_the_ten_lines_run(tmp_path, monkeypatch, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    config = SimulationConfig(seed=4, duration=90.0, density="suburb", static_start=15.0)
    simulate_folder(config, tmp_path / "Dataset_campus-01")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)
    assert float(capsys.readouterr().out) < 5.0
    assert all(u.reason for u in names["refused"])
