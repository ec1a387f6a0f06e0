"""Trains a scene and draws the curve of its loss in the terminal: python train.py capture trained"""
import sys
from typing import Any

import qirf_vk

if len(sys.argv) != 3:
    sys.exit(__doc__)


def draw(step: dict[str, Any]) -> None:
    loss = step["loss"] or 0.0  # None where it is no number
    bar = "#" * round(200 * loss)
    psnr = f'  {step["psnr"]:.2f} dB' if "psnr" in step else ""
    print(f'{step["iteration"]:6} {step["gaussians"]:8} {loss:.4f} {bar}{psnr}', flush=True)


run = qirf_vk.train(sys.argv[1], preset="quick", output=sys.argv[2], resume=True, resolution="256", on_step=draw)
print(run.model, run.record["test"])
