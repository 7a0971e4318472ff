"""Kill one of two workers midway through a benchmark, and compare with a run that was left in peace.

``python benchmarks/kill_a_worker.py --set smoke --method epipolar --count 8 -o killed`` writes ``killed/spread`` (two
workers, one of them killed once a quarter of the cases is done) and ``killed/serial`` (one process), and leaves by 0
if every case is there, none twice, and all records are the same but for their seconds.
"""

import argparse
import json
import os
import signal
import sys
import threading
from pathlib import Path
from time import sleep
from typing import Any

# Before numpy is imported: the last digit of a long sum depends on how many threads share it.
os.environ["OPENBLAS_NUM_THREADS"] = "1"


def main() -> int:
    """Run twice, kill once, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", default="smoke", help="where the cases come from")
    parser.add_argument("--method", default="epipolar", help="what solves them")
    parser.add_argument("--count", type=int, default=8, help="cases")
    parser.add_argument("--seed", type=int, default=1, help="of the cases")
    parser.add_argument("--generations", type=int, default=60, help="of a search by loss")
    parser.add_argument("-o", "--out", type=Path, default=Path("killed"))
    asked = parser.parse_args()
    from distributed import LocalCluster

    from screwpose.benchmark import make_request, run_bench
    from screwpose.registration import SearchOptions
    from screwpose.solve import SolveOptions

    request = make_request(
        sets=asked.set.split(","),
        methods=asked.method.split(","),
        count=asked.count,
        seed=asked.seed,
        options=SolveOptions(search=SearchOptions(generations=asked.generations)),
    )
    spread, serial = asked.out / "spread", asked.out / "serial"
    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0") as cluster:
        killer = threading.Thread(target=_kill_one, args=(cluster, spread, request.cases // 4 or 1), daemon=True)
        killer.start()
        run_bench(request, spread, scheduler=cluster.scheduler_address, progress=_say)
    run_bench(request, serial, progress=_say)
    wanted = request.cases * len(request.methods)
    found = len(_records(spread))
    same = _records(spread) == _records(serial)
    _say(1.0, f"{found} of {wanted} records, {'the same as' if same else 'NOT THOSE'} of the serial run")
    return 0 if same and found == wanted and not killer.is_alive() else 1


def _kill_one(cluster: Any, folder: Path, after: int) -> None:
    from distributed import Client

    with Client(cluster, set_as_default=False) as client:
        while len(list(folder.glob("records/*/*.json"))) < after:
            sleep(0.2)
        pid = min(client.run(os.getpid).values())
        os.kill(pid, signal.SIGKILL)
        _say(0.0, f"killed the worker with process id {pid}")


def _records(folder: Path) -> dict[str, Any]:
    return {
        str(path.relative_to(folder)): _without_times(json.loads(path.read_text()))
        for path in folder.glob("records/*/*.json")
    }


def _without_times(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _without_times(value) for key, value in data.items() if key not in ("seconds", "timing_s")}
    return [_without_times(one) for one in data] if isinstance(data, list) else data


def _say(_fraction: float, what: str) -> None:
    if ": " not in what:  # not every step of every case
        sys.stderr.write(f"{what}\n")


if __name__ == "__main__":
    sys.exit(main())
