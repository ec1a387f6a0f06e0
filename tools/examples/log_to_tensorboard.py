"""Shows a run in TensorBoard while it trains: python log_to_tensorboard.py trained runs/first

Needs `pip install tensorboardX`. Ends with the run's last iteration; start it before or after the run.
"""
import json
import sys
import time
from pathlib import Path

from tensorboardX import SummaryWriter

log, writer = Path(sys.argv[1]) / "log.jsonl", SummaryWriter(sys.argv[2])
seen, line = 0, {"iteration": 0, "iterations": 1}
while line["iteration"] < line["iterations"]:
    lines = log.read_text().splitlines(keepends=True) if log.exists() else []
    for text in (text for text in lines[seen:] if text.endswith("\n")):
        seen, line = seen + 1, json.loads(text)
        values = {**line, **{f"rates/{name}": rate for name, rate in line["rates"].items()}}
        for name in values.keys() - {"iteration", "iterations", "rates"}:
            if values[name] is not None:
                writer.add_scalar(name, values[name], line["iteration"])
    writer.flush()
    time.sleep(1)
