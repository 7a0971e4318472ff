"""The timing command runs, checks its rivals, and writes what it found."""

import csv
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_quick_run_times_everything_and_checks_the_masks(tmp_path: Path) -> None:
    out = tmp_path / "engines"
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "engines.py"), "--quick", "--clock", "cpu", "-o", str(out)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((out / "engines.csv").read_text().splitlines()))
    by_job = {row["job"]: row for row in rows if row["block"] == "scene"}
    assert float(by_job["bit rows face by face, full CAD"]["same"]) == 1.0
    assert 0.95 < float(by_job["OpenCV, a call a triangle, full CAD"]["same"]) < 1.0  # it paints outlines too
    for row in rows:
        assert 0.0 < float(row["us_low"]) <= float(row["us"]) <= float(row["us_high"])
    blocks = {row["block"] for row in rows}
    assert blocks == {"scene", "lengths", "triangles", "pixels", "screws", "threads"}
    bound = float(by_job["lower bound, 2,000 faces"]["us"])
    opencv = float(by_job["OpenCV, a call a triangle, full CAD"]["us"])
    assert bound < float(by_job["ours, 2,000 faces"]["us"]) < opencv
    text = (out / "engines.md").read_text()
    assert "not the reference's: 0 reduced" in text
    assert "| 1000 | ours |" in text
    assert (out / "engines.png").read_bytes().startswith(b"\x89PNG")
