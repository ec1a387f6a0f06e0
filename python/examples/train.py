"""Trains a scene and draws the curve of its loss in the terminal: python train.py capture trained"""
import sys

import qirf_vk


def draw(step):
    bar = "#" * round(200 * (step["loss"] or 0))
    psnr = f'  {step["psnr"]:.2f} dB' if "psnr" in step else ""
    print(f'{step["iteration"]:6} {step["gaussians"]:8} {step["loss"]:.4f} {bar}{psnr}', flush=True)


run = qirf_vk.train(sys.argv[1], preset="quick", output=sys.argv[2], resume=True, resolution="256", on_step=draw)
print(run.model, run.record["test"])
