"""Renders an orbit of a model to NumPy files: python orbit.py flowers.ply pictures"""
import sys
from pathlib import Path

import numpy as np
import qirf_vk

if len(sys.argv) != 3:
    sys.exit(__doc__)

model, folder = qirf_vk.Model.load(sys.argv[1]), Path(sys.argv[2])
folder.mkdir(exist_ok=True)
renderer = qirf_vk.Renderer(model, background=(1, 1, 1))
for number, camera in enumerate(qirf_vk.orbit(model, 8, size=(640, 480))):
    np.save(folder / f"colour_{number}.npy", renderer.render(camera))
    np.save(folder / f"depth_{number}.npy", renderer.depth(camera))
print(f"{model}: 8 pictures in {folder}")
