#!/usr/bin/env python3
"""Oracle of the training loss 0.8 L1 + 0.2 (1 - SSIM), in nothing but Python's float64: `python3 loss.py > loss.json`.

It shares no code and no formula of the gradient with the engine: the window is taken as a dense sum over pixels, and
derivatives are complex steps, f(x + ih) = f(x) + ih f'(x), exact to rounding.
"""
import json, math

WIDTH, HEIGHT, RADIUS, SIGMA, WEIGHT, C1, C2 = 13, 9, 5, 1.5, 0.2, 0.01**2, 0.03**2
STEP = 1e-30


def draws(seed):
    """Numbers in [0, 1), float32 exactly: a linear congruential generator's upper 20 bits."""
    while True:
        seed = (6364136223846793005 * seed + 1442695040888963407) % 2**64
        yield (seed >> 44) / 2**20


def window():
    line = [math.exp(-(d * d) / (2 * SIGMA * SIGMA)) for d in range(-RADIUS, RADIUS + 1)]
    total = sum(line)
    return {(i, j): line[i + RADIUS] * line[j + RADIUS] / total**2
            for i in range(-RADIUS, RADIUS + 1) for j in range(-RADIUS, RADIUS + 1)}


WINDOW = window()


def ssim_at(x, y, column, row):
    """SSIM at a pixel; the picture is zero outside its border."""
    ux = uy = xx = yy = xy = 0
    for (i, j), w in WINDOW.items():
        c, r = column + i, row + j
        if 0 <= c < WIDTH and 0 <= r < HEIGHT:
            a, b = x[r * WIDTH + c], y[r * WIDTH + c]
            ux, uy, xx, yy, xy = ux + w * a, uy + w * b, xx + w * a * a, yy + w * b * b, xy + w * a * b
    return ((2 * ux * uy + C1) * (2 * (xy - ux * uy) + C2)
            / ((ux * ux + uy * uy + C1) * (xx - ux * ux + yy - uy * uy + C2)))


def main():
    count = WIDTH * HEIGHT
    random = draws(7)
    rendered, truth, gradient, l1, ssim = [], [], [], [], []
    for channel in range(3):
        x = [next(random) for _ in range(count)]
        # Bytes of the photo: close to the picture in one channel, anything in the others. In a corner both are black or
        # white: where they are equal L1 has no slope.
        bytes_ = [round(255 * x[p]) if channel == 1 else int(256 * next(random)) for p in range(count)]
        for p in (row * WIDTH + column for row in range(4) for column in range(2)):
            x[p] = p % 2
            bytes_[p] = 255 * (p % 2)
        y = [byte / 255 for byte in bytes_]
        l1 += [abs(a - b) for a, b in zip(x, y)]
        ssim += [ssim_at(x, y, p % WIDTH, p // WIDTH) for p in range(count)]
        slopes = []
        for p in range(count):
            moved = x[:p] + [x[p] + STEP * 1j] + x[p + 1:]
            near = [(c, r) for c in range(p % WIDTH - RADIUS, p % WIDTH + RADIUS + 1) if 0 <= c < WIDTH
                    for r in range(p // WIDTH - RADIUS, p // WIDTH + RADIUS + 1) if 0 <= r < HEIGHT]
            by_ssim = math.fsum(ssim_at(moved, y, c, r).imag / STEP for c, r in near)
            by_l1 = (x[p] > y[p]) - (x[p] < y[p])
            slopes.append(((1 - WEIGHT) * by_l1 - WEIGHT * by_ssim) / (3 * count))
        rendered.append(x), truth.append(bytes_), gradient.append(slopes)
    l1, ssim = math.fsum(l1) / (3 * count), math.fsum(ssim) / (3 * count)
    print(json.dumps({"width": WIDTH, "height": HEIGHT, "ssim_weight": WEIGHT, "rendered": rendered, "truth": truth,
                      "l1": l1, "ssim": ssim, "loss": (1 - WEIGHT) * l1 + WEIGHT * (1 - ssim), "gradient": gradient}))


if __name__ == "__main__":
    main()
