"""What the tests share. $QIRF_PROGRAM is the program whose bytes the package must have: tools/python-test sets it."""
import os
import subprocess
from pathlib import Path

import pytest
import qirf_vk

ROOT = Path(__file__).resolve().parents[2]
RING = ROOT / "tools" / "examples" / "ring.ply"
PROGRAM = os.environ["QIRF_PROGRAM"]


def program(*arguments):
    subprocess.run([PROGRAM, "--quiet", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


@pytest.fixture(scope="session")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene") / "scene"
    program("synth", folder, "--views", 9, "--size", "48x36")
    return folder


@pytest.fixture(scope="session")
def trained(scene):
    return qirf_vk.train(scene, iterations=120)


@pytest.fixture(scope="session")
def ring():
    return qirf_vk.Model.load(RING)


def arrays(model):
    return model.means, model.log_scales, model.rotations, model.opacity_logits, model.sh
