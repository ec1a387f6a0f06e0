"""What is left of a model at each size: python sizes.py flowers.ply"""
import sys

import qirf_vk

if len(sys.argv) != 2:
    sys.exit(__doc__)

model = qirf_vk.Model.load(sys.argv[1])
print("share  Gaussians    dB")
for share in (0.5, 0.28, 0.1, 0.05):
    small, record = qirf_vk.compress(model, share)
    print(f'{share:5}  {len(small):9}  {record["test"]["pruned"]["psnr"]:.2f}')
