"""PSNR of a model's files against their size: python sizes.py flowers.ply"""
import os
import sys
import tempfile

import qirf_vk

if len(sys.argv) != 2:
    sys.exit(__doc__)

model = qirf_vk.Model.load(sys.argv[1])
whole = os.path.getsize(sys.argv[1])
print("     bytes  Gaussians     dB")
with tempfile.TemporaryDirectory() as folder:
    for part in (5, 10, 20, 40, 80):
        output = os.path.join(folder, f"{part}.sog")
        small, record = qirf_vk.compress(model, size=whole // part, output=output)
        psnr = record["test"]["written"]["psnr"]  # None where pictures are equal
        print(f'{os.path.getsize(output):10}  {len(small):9}  {"equal" if psnr is None else f"{psnr:5.2f}"}')
