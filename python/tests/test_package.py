"""Tests of the Python package against the program, whose bytes it must have."""
import ast
import errno
import inspect
import json
import logging
import pickle
import signal
import subprocess
import sys
import threading
import time
import warnings
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import qirf_vk
from conftest import RING, ROOT, arrays, program


def test_arrays_are_views_that_nobody_writes_to(ring):
    n = len(ring)
    assert ring.means.shape == (n, 3) and ring.log_scales.shape == (n, 3) and ring.rotations.shape == (n, 4)
    assert ring.opacity_logits.shape == (n,) and [b.shape for b in ring.sh] == [(n, 2 * l + 1, 3) for l in range(ring.degree + 1)]
    for array in [ring.means, ring.log_scales, ring.rotations, ring.opacity_logits, *ring.sh]:
        assert array.dtype == np.float32 and not array.flags.writeable and not array.flags.owndata
        with pytest.raises(ValueError):
            array[0] = 1
        with pytest.raises(ValueError):
            array.flags.writeable = True
    assert ring.means.__array_interface__["data"] == ring.means.__array_interface__["data"]
    means = qirf_vk.Model.load(RING).means
    assert np.isfinite(means).all(), "an array keeps its model alive"


def test_save_and_from_arrays_keep_every_byte(ring, tmp_path):
    ring.save(tmp_path / "saved.ply")
    program("convert", RING, tmp_path / "converted.ply")
    again = qirf_vk.Model.from_arrays(*arrays(ring))
    again.save(tmp_path / "again.ply")
    whole = np.concatenate(ring.sh, axis=1)
    qirf_vk.Model.from_arrays(*arrays(ring)[:4], whole.astype(np.float64)).save(str(tmp_path / "whole.ply"))
    expected = (tmp_path / "converted.ply").read_bytes()
    for name in ["saved", "again", "whole"]:
        assert (tmp_path / f"{name}.ply").read_bytes() == expected, name
    ring.save(tmp_path / "model.spz")
    program("convert", RING, tmp_path / "program.spz")
    assert (tmp_path / "model.spz").read_bytes() == (tmp_path / "program.spz").read_bytes()


def test_spz_has_the_bits_and_the_version_that_are_asked_for(ring, tmp_path):
    sh = np.random.default_rng(1).normal(0, 0.2, (len(ring), 9, 3))
    model = qirf_vk.Model.from_arrays(*arrays(ring)[:4], sh)
    model.save(tmp_path / "model.ply")
    for name, given, options in (
        ("two", {"sh_bits": (6, 5)}, ["--sh-bits", "6,5"]),
        ("old", {"sh_bits": 8, "spz_version": 3}, ["--sh-bits", 8, "--spz-version", 3]),
    ):
        model.save(tmp_path / f"{name}.spz", **given)
        program("convert", tmp_path / "model.ply", tmp_path / f"{name}-program.spz", *options)
        assert (tmp_path / f"{name}.spz").read_bytes() == (tmp_path / f"{name}-program.spz").read_bytes(), name
    for text, name, given in (
        ("sh_bits=9: give 1 to 8, or two", "x.spz", {"sh_bits": 9}),
        ("sh_bits=True: give 1 to 8, or two", "x.spz", {"sh_bits": True}),
        ("give 1 to 8, or two", "x.spz", {"sh_bits": (True, 5)}),
        ("give 1 to 8, or two", "x.spz", {"sh_bits": b"\x06\x05"}),
        ("spz_version=5: give 3 or 4", "x.spz", {"spz_version": 5}),
        ("name an .spz file", "x.sog", {"sh_bits": [6, 5]}),
    ):
        with pytest.raises(ValueError, match=text):
            model.save(tmp_path / name, **given)


def test_models_far_from_the_origin_keep_their_place(ring, tmp_path):
    place = (500_000.0, 4_100_000.0, 30.0)
    far = qirf_vk.Model.from_arrays(*arrays(ring), origin=place)
    far.save(tmp_path / "far.ply")
    assert json.loads((tmp_path / "georeference.json").read_text())["origin"] == list(place)
    again = qirf_vk.Model.load(tmp_path / "far.ply")
    assert again.origin == place == again.move_by((1, 0, 0)).origin and ring.origin == (0, 0, 0)
    assert (again.means == ring.means).all()
    near = qirf_vk.Model.from_arrays(*arrays(ring), origin=(place[0] + 2, *place[1:]))
    both = qirf_vk.merge([far, near])
    assert both.origin == place and np.allclose(both.means[len(ring):], ring.means + [2, 0, 0])
    small, _ = qirf_vk.compress(far, 0.5, views=4, picture_size=(48, 48))
    program("compress", tmp_path / "far.ply", "-o", tmp_path / "small.ply", "--keep", 0.5, "--views", 4, "--size", "48x48")
    small.save(tmp_path / "python.ply")
    assert small.origin == place and (tmp_path / "python.ply").read_bytes() == (tmp_path / "small.ply").read_bytes()
    with pytest.raises(ValueError, match="origin"):
        qirf_vk.Model.from_arrays(*arrays(ring), origin=(np.nan, 0, 0))


def test_wrong_arrays_are_named(ring):
    means, scales, rotations, logits, sh = arrays(ring)
    make = qirf_vk.Model.from_arrays
    with pytest.raises(ValueError, match=r"means has the shape \(2, 2\), and should have \(n, 3\)"):
        make(np.zeros((2, 2)), scales, rotations, logits, sh)
    with pytest.raises(ValueError, match="log_scales has 3 entries"):
        make(means, scales[:3], rotations, logits, sh)
    with pytest.raises(ValueError, match=r"sh\[0\] has the shape"):
        make(means, scales, rotations, logits, [np.zeros((3, 1, 3))])
    broken = rotations.copy()
    broken[5] = 0
    with pytest.raises(ValueError, match="Gaussian 5: its rotation"):
        make(means, scales, broken, logits, sh)
    broken = means.copy()
    broken[2, 1] = np.nan
    with pytest.raises(ValueError, match="Gaussian 2: its mean is not finite"):
        make(broken, scales, rotations, logits, sh)
    with pytest.raises(ValueError, match="means"):
        make("no array", scales, rotations, logits, sh)
    broken = rotations.copy()
    broken[4, 1] = np.nan
    with pytest.raises(ValueError, match="Gaussian 4: its rotation is not finite"):
        make(means, scales, broken, logits, sh)
    with warnings.catch_warnings(), pytest.raises(ValueError, match="means has numbers that are too large for float32"):
        warnings.simplefilter("error")
        make(np.full(means.shape, 1e39), scales, rotations, logits, sh)
    one = ring.select([0])
    with pytest.raises(ValueError, match=r"opacity_logits has the shape \(\), and should have \(1,\)"):
        make(one.means, one.log_scales, one.rotations, 0.5, one.sh)
    broken = scales.copy()
    broken[3, 0] = 200
    with pytest.raises(ValueError, match="Gaussian 3: its log_scales are too large"):
        make(means, broken, rotations, logits, sh)


def test_short_rotations_and_large_scales_are_kept(ring):
    means, scales, rotations, logits, sh = arrays(ring)
    short = qirf_vk.Model.from_arrays(means, scales, rotations * np.float32(1e-18), logits, sh).rotations
    units = [turns / np.linalg.norm(turns, axis=1, keepdims=True) for turns in (short, rotations)]
    assert np.allclose(*units, atol=1e-5)
    large = qirf_vk.Model.from_arrays(means, np.full_like(scales, 29.9), rotations, logits, sh).scale(10)
    assert (pickle.loads(pickle.dumps(large)).log_scales == large.log_scales).all() and large.log_scales.max() > 30
    with pytest.raises(ValueError, match="Gaussian 0: its log_scales .* should be less than 30"):
        qirf_vk.Model.from_arrays(means, np.full_like(scales, 30), rotations, logits, sh)
    one = qirf_vk.Model.from_arrays([[0, 0, 5]], [[29.9] * 3], [[1, 0, 0, 0]], [3.0], np.zeros((1, 1, 3)))
    camera = qirf_vk.Camera.look_at((0, 0, 0), (0, 0, 1), size=(32, 24))
    assert qirf_vk.Renderer(one).render(camera)[..., 3].min() > 0.9, "what is accepted is drawn"


def test_errors_have_their_kinds(ring, tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere.ply") as missing:
        qirf_vk.Model.load(tmp_path / "nowhere.ply")
    assert missing.value.errno == errno.ENOENT and missing.value.filename == str(tmp_path / "nowhere.ply")
    assert "os error" not in str(missing.value)
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat nonsense\n")
    with pytest.raises(ValueError, match="broken.ply"):
        qirf_vk.Model.load(tmp_path / "broken.ply")
    with pytest.raises(ValueError, match="extension|format|write"):
        ring.save(tmp_path / "model.doc")
    with pytest.raises(OSError, match="no/folder"):
        ring.save(tmp_path / "no" / "folder" / "model.ply")
    with pytest.raises(qirf_vk.DeviceError):
        qirf_vk.Device("a device that nobody has")
    with pytest.raises(qirf_vk.DeviceError):
        qirf_vk.Device("5555")  # an index, also where a name contains it
    with pytest.raises(qirf_vk.DeviceError, match=str(2**70)):
        qirf_vk.Device(2**70)
    with pytest.raises(FileNotFoundError):
        qirf_vk.train(tmp_path / "no scene", preset="quick")
    with pytest.raises(TypeError, match="sead: did you mean seed"):
        qirf_vk.train(tmp_path, sead=3)
    with pytest.raises(ValueError, match="preset"):
        qirf_vk.train(tmp_path, preset="fast")
    with pytest.raises(ValueError, match="keep"):
        qirf_vk.compress(ring, keep=1.5)
    with pytest.raises(ValueError, match="scene"):
        qirf_vk.evaluate(ring)
    with pytest.raises(ValueError, match="give one of them"):
        qirf_vk.evaluate(ring, tmp_path, against=ring)
    wrong = {
        "count=0: give 1 or more": lambda: qirf_vk.compress(ring, count=0),
        "count=-3: give a number from 1": lambda: qirf_vk.train(tmp_path, count=-3),
        "keep=3: give a share": lambda: qirf_vk.train(tmp_path, keep=3),
        "seed is \"x\", a whole number is needed": lambda: qirf_vk.train(tmp_path, seed="x", sh_degree=1),
        "does not read merge; choose another selector": lambda: qirf_vk.compress(ring, 0.5, merge=False),
        "detail=2: give a share": lambda: qirf_vk.compress(ring, 0.5, selector="css", detail=2),
        'budget is "all": give one of': lambda: qirf_vk.compress(ring, 0.5, selector="css", budget="all"),
        "views=1: give 2 or more": lambda: qirf_vk.compress(ring, views=1),
        "looks from eye": lambda: qirf_vk.Camera.look_at((1, 2, 3), (1, 2, 3)),
        "radius above 0": lambda: ring.crop_ball((0, 0, 0), -1),
        "box is empty": lambda: ring.crop_box((1, 1, 1), (-1, 2, 2)),
        "opacity=2": lambda: ring.min_opacity(2),
        "degree=-1": lambda: ring.with_degree(-1),
        "degree=4": lambda: ring.with_degree(4),
        "ratio=0": lambda: ring.remove("needles", ratio=0),
        "psnr=500": lambda: qirf_vk.compress(ring, psnr=500, output=tmp_path / "x.sog"),
        "picture_size": lambda: qirf_vk.compress(ring, picture_size=(0, 3)),
        "views and picture_size are": lambda: qirf_vk.compress(ring, views=4, scene=tmp_path),
        "exposures are fitted to a scene's photos": lambda: qirf_vk.compress(ring, exposure=True),
        "resolution is of a scene's photos": lambda: qirf_vk.evaluate(ring, against=ring, resolution=20),
        "background=": lambda: qirf_vk.Renderer(ring, background=(2, 0, 0)),
        "K should be": lambda: qirf_vk.Camera(np.diag([9, 9, 2]), np.eye(4), (4, 4)),
        "last row": lambda: qirf_vk.Camera(np.diag([9, 9, 1]), np.diag([1, 1, 1, 2]), (4, 4)),
        "near=0": lambda: qirf_vk.Camera(np.diag([9, 9, 1]), np.eye(4), (4, 4), near=0),
        "fine_tune=-1: give 0 or more": lambda: qirf_vk.compress(ring, fine_tune=-1),
        "seed=-1: give 0 or more": lambda: qirf_vk.compress(ring, seed=-1),
        "seed: give a smaller number": lambda: qirf_vk.compress(ring, seed=2**64 - 1),
        "count: give 1 or more": lambda: qirf_vk.compress(ring, count=-(10**30)),
        "degree: give one from 0": lambda: ring.with_degree(10**30),
        r"picture_size=\(-5, 3\)": lambda: qirf_vk.compress(ring, picture_size=(-5, 3)),
        "size: give 1 to 65,536 pixels": lambda: qirf_vk.Camera(np.diag([9, 9, 1]), np.eye(4), (4, 10**30)),
        "eval_every=-1": lambda: qirf_vk.evaluate(ring, tmp_path, eval_every=-1),
        "memory_limit=-1": lambda: qirf_vk.Device(memory_limit=-1),
        "offset=": lambda: ring.move_by((0, np.nan, 0)),
        "keep=nan": lambda: qirf_vk.train(tmp_path, keep=np.nan),
        "iterations=inf": lambda: qirf_vk.train(tmp_path, iterations=np.inf),
        "iterations=-1: give a number from 1": lambda: qirf_vk.train(tmp_path, iterations=-1),
        r"seed: give a number below 2\^63": lambda: qirf_vk.train(tmp_path, seed=2**70),
        r"seed: give a number above -2\^63": lambda: qirf_vk.train(tmp_path, seed=-(10**30)),
        "seed=9223372036854775808: give a smaller number": lambda: qirf_vk.train(tmp_path, seed=2**63),
        'init is 3: give "points", "random", the path of a model, or a Model': lambda: qirf_vk.train(tmp_path, init=3),
        "init: the model has no Gaussian": lambda: qirf_vk.train(tmp_path, init=ring.select([])),
        "the model has no Gaussian": lambda: qirf_vk.compress(ring.select([])),
        "matrix: could not convert": lambda: ring.transform([["x"]]),
        "K: .*could not convert": lambda: qirf_vk.Camera("x", np.eye(4), (4, 4)),
        "low: expected a sequence of length 3": lambda: ring.crop_box((0, 0), (1, 1, 1)),
        "views=4294967295: give at most": lambda: qirf_vk.compress(ring, 0.5, views=2**32 - 1),
        "count=4000000000: give at most": lambda: qirf_vk.orbit(ring, 4 * 10**9),
        "target=.*: give finite numbers": lambda: qirf_vk.Camera.look_at((0, 0, -3), target=(np.nan, 0, 0)),
        "up has length 0": lambda: qirf_vk.Camera.look_at((0, 0, -3), up=(0, 0, 0)),
        r"but K\[0, 1\] is 1e-17": lambda: qirf_vk.Camera([[9, 1e-17, 0], [0, 9, 0], [0, 0, 1]], np.eye(4), (4, 4)),
        "eval_every is of a scene's photos": lambda: qirf_vk.evaluate(ring, against=ring, eval_every=3),
        "resolution=32.0: give a width in pixels": lambda: qirf_vk.evaluate(ring, tmp_path, resolution=32.0),
        "size has 3 numbers": lambda: qirf_vk.Camera(np.diag([9, 9, 1]), np.eye(4), [4, 4, 4]),
        "background": lambda: qirf_vk.train(tmp_path, background=np.ones(2)),
        "near=NaN": lambda: qirf_vk.Camera(np.diag([9, 9, 1]), np.eye(4), (4, 4), near=np.nan),
    }
    for text, call in wrong.items():
        with pytest.raises(ValueError, match=text):
            call()
    with pytest.raises(IndexError, match=f"no Gaussian -{len(ring) + 1} among {len(ring)}"):
        ring.select([0, -len(ring) - 1])
    with pytest.raises(IndexError, match=f"no Gaussian {2**63} among {len(ring)}"):
        ring.select(np.array([0, 2**63], "u8"))


def test_arguments_of_wrong_types_are_named(ring, tmp_path):
    wrong = {
        "keep: must be real number": lambda: qirf_vk.compress(ring, "0.3"),
        "size: 'int' object is not iterable": lambda: qirf_vk.Camera(np.eye(3), np.eye(4), 5),
        "picture_size: 'float' object": lambda: qirf_vk.compress(ring, picture_size=(4.5, 3)),
        "offset: ": lambda: ring.move_by(3),
        "up: must be real number": lambda: qirf_vk.orbit(ring, 2, up=("x", 0, 0)),
        "chosen is of type set: give": lambda: ring.select({1, 2}),
        "chosen is of type NoneType: give": lambda: ring.select(None),
        "means is None: give an array": lambda: qirf_vk.Model.from_arrays(None, *arrays(ring)[1:]),
        "on_step should be a function": lambda: qirf_vk.train(tmp_path, output=tmp_path / "run", on_step=3),
        "on_progress should be a function": lambda: qirf_vk.evaluate(ring, against=ring, on_progress="print"),
    }
    for text, call in wrong.items():
        with pytest.raises(TypeError, match=text):
            call()
    assert not list(tmp_path.iterdir()), "nothing was written"


def test_help_says_what_the_stubs_say():
    checked = 0

    def check(thing, node):
        nonlocal checked
        if (text := ast.get_docstring(node)) is not None:
            assert inspect.getdoc(thing) == text, node
            checked += 1

    stubs = ast.parse((ROOT / "python" / "qirf_vk.pyi").read_text())
    check(qirf_vk, stubs)
    for node in stubs.body:
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
            check(getattr(qirf_vk, node.name), node)
        for member in [m for m in getattr(node, "body", []) if isinstance(node, ast.ClassDef) and isinstance(m, ast.FunctionDef)]:
            check(getattr(getattr(qirf_vk, node.name), member.name), member)
    assert checked > 40


def test_pictures_are_the_programs(ring, tmp_path):
    program("render", RING, "--orbit", 2, "--size", "64x48", "--format", "npy", "-o", tmp_path)
    renderer = qirf_vk.Renderer(ring)
    for number, camera in enumerate(qirf_vk.orbit(ring, 2, size=(64, 48))):
        picture = renderer.render(camera)
        expected = np.load(tmp_path / f"orbit_{number:03}.npy")
        assert picture.shape == (48, 64, 4) and picture.dtype == np.float32
        assert picture[..., : expected.shape[2]].tobytes() == expected.tobytes()
        again = renderer.render(qirf_vk.Camera(camera.K, camera.world_to_camera, camera.size))
        assert np.allclose(picture, again, atol=1e-5)
        by_matrices = renderer.render(camera.K, camera.world_to_camera[:3], camera.size)
        assert by_matrices.tobytes() == again.tobytes()
        shared = np.from_dlpack(picture)
        assert shared.__array_interface__["data"] == picture.__array_interface__["data"]
    with pytest.raises(ValueError, match="rotation"):
        qirf_vk.Camera(np.eye(3), np.ones((4, 4)), (8, 8))
    with pytest.raises(ValueError, match="give a Camera"):
        renderer.render(np.eye(3))


def test_depth_is_the_distance_along_the_axis():
    one = [[0.3, -0.2, 5.0]]
    model = qirf_vk.Model.from_arrays(one, [[-1.0] * 3], [[1, 0, 0, 0]], [4.0], [np.zeros((1, 1, 3))])
    camera = qirf_vk.Camera.look_at((0, 0, 0), (0, 0, 1), fov=60, size=(64, 48))
    renderer = qirf_vk.Renderer(model)
    depth = renderer.depth(camera)
    seen = np.isfinite(depth)
    assert depth.shape == (48, 64) and 0 < seen.sum() < seen.size and np.allclose(depth[seen], 5.0, atol=1e-4)
    middle = renderer.depth(camera, kind="median")
    solid = np.isfinite(middle)
    assert (renderer.render(camera)[..., 3] > 0.5)[solid].all() and 0 < solid.sum() < seen.sum()
    assert np.allclose(middle[solid], 5.0, atol=1e-4)
    with pytest.raises(ValueError, match='give "expected" or "median"'):
        renderer.depth(camera, kind="mean")


def test_pictures_are_shared_with_torch(ring):
    torch = pytest.importorskip("torch")
    picture = qirf_vk.Renderer(ring).render(qirf_vk.orbit(ring, 1, size=(32, 24))[0])
    tensor = torch.from_dlpack(picture)
    assert tensor.shape == (24, 32, 4) and tensor.data_ptr() == picture.__array_interface__["data"][0]
    tensor[0, 0, 0] = 2.0
    assert picture[0, 0, 0] == 2.0


def test_edits_make_new_models(ring):
    n, before = len(ring), ring.means.copy()
    moved = ring.move_by((1, 2, 3))
    assert np.allclose(moved.means, before + [1, 2, 3]) and (ring.means == before).all()
    matrix = np.eye(4)
    matrix[:3, 3] = (1, 2, 3)
    assert (ring.transform(matrix).means == moved.means).all()
    assert np.allclose(ring.turn((0, 0, 1), 90).means[:, 0], -before[:, 1], atol=1e-6)
    assert np.allclose(ring.scale(2).log_scales, ring.log_scales + np.log(2), atol=1e-6)
    half = ring.crop_box((-100, -100, -100), (0, 100, 100))
    assert len(half) + len(ring.crop_box((-100, -100, -100), (0, 100, 100), outside=True)) == n and 0 < len(half) < n
    assert len(ring.crop_ball((0, 0, 0), 1000)) == n and ring.with_degree(0).degree == 0
    assert (ring.select(before[:, 0] > 0).means == before[before[:, 0] > 0]).all()
    assert (ring.select([3, 1]).means == before[[3, 1]]).all()
    assert len(qirf_vk.merge([ring, moved])) == 2 * n and len(ring.morton_order()) == n
    with pytest.warns(UserWarning, match="rounded to about"):
        far = qirf_vk.Model.from_arrays(ring.means + np.float32([5e5, 4e6, 0]), *arrays(ring)[1:])
    utm = (500_000.0, 4_000_000.0, 0.0)
    local = qirf_vk.Model.from_arrays(ring.means, ring.log_scales, ring.rotations, ring.opacity_logits, ring.sh, origin=utm)
    both = qirf_vk.merge([far, local])
    assert both.origin == utm and (both.means[n:] == ring.means).all()
    assert len(ring.min_opacity(0)) == n and len(ring.max_size(1e9)) == n and len(ring.remove("invisible")) <= n
    with pytest.raises(ValueError):
        ring.remove("ugly")
    with pytest.raises(ValueError):
        ring.transform(np.diag([1, 2, 3, 1]))


def test_scenes_crop_and_clean_as_the_program_does(scene, trained, tmp_path):
    trained.model.save(tmp_path / "model.ply")

    def edited(*options):
        program("edit", tmp_path / "model.ply", "-o", tmp_path / "edited.ply", *options)
        return (tmp_path / "edited.ply").read_bytes()

    for model, *options in [
        (trained.model.crop_views(scene, least=4), "--crop-views", scene, "--least-views", 4),
        (trained.model.remove("floaters"), "--remove", "floaters"),
        (trained.model.remove("floaters", scene=scene), "--remove", "floaters", "--scene", scene),
    ]:
        model.save(tmp_path / "python.ply")
        assert (tmp_path / "python.ply").read_bytes() == edited(*options), options
    with pytest.raises(ValueError, match="at least 100 photos: .* has 9 photos"):
        trained.model.crop_views(scene, least=100)
    with pytest.raises(ValueError, match="scene is for kind"):
        trained.model.remove("needles", scene=scene)


def test_training_is_the_programs(scene, trained, tmp_path):
    program("run", scene, "-o", tmp_path / "run", "--iterations", 120)
    trained.model.save(tmp_path / "model.ply")
    assert (tmp_path / "model.ply").read_bytes() == (tmp_path / "run" / "model.ply").read_bytes()
    record = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert trained.record["test"] == record["test"] and trained.record["gaussians"] == record["gaussians"]
    assert trained.log[-1]["iteration"] == 120 and trained.folder is None
    program("run", scene, "-o", tmp_path / "styled", "--iterations", 20, "--antialias", "--sh-degree", 1)
    styled = qirf_vk.train(scene, iterations=20, antialias=True, sh_degree=1, output=tmp_path / "again")
    assert styled.model.antialiased
    assert (tmp_path / "again" / "model.ply").read_bytes() == (tmp_path / "styled" / "model.ply").read_bytes()
    options = {"antialias": True, "sh_degree": 1, "output": tmp_path / "again", "resume": True}
    assert qirf_vk.train(scene, iterations=20, **options).record == styled.record
    with pytest.raises(ValueError, match="schedule.iterations was 20, is 21"):
        qirf_vk.train(scene, iterations=21, **options)
    steps = []
    dense = qirf_vk.train(scene, iterations=40, prune=False, output=tmp_path / "dense", on_step=steps.append)
    assert steps == dense.log and dense.folder is not None and (Path(dense.folder) / "config.toml").exists()


def test_outputs_are_checked_before_any_work(ring, tmp_path):
    calls, small = [], {"views": 2, "picture_size": (24, 24), "on_progress": lambda *told: calls.append(told)}
    (tmp_path / "x.ply").mkdir()
    for output, kind in ((tmp_path / "no" / "x.ply", FileNotFoundError), (tmp_path / "x.ply", ValueError)):
        with pytest.raises(kind, match="x.ply"):
            qirf_vk.compress(ring, 0.5, output=output, **small)
    for name in ("config.toml", "model.ply"):
        (tmp_path / name).write_text("a run's")
    for call in (lambda: ring.save(tmp_path / "model.ply"), lambda: qirf_vk.compress(ring, 0.5, output=tmp_path / "model.sog", **small)):
        with pytest.raises(ValueError, match="is a run's model, which the figures beside it describe"):
            call()
    assert not calls and (tmp_path / "model.ply").read_text() == "a run's"
    (tmp_path / "arms").mkdir()
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "model.ply").write_text("of nobody")
    for folder, said in ((tmp_path, "holds a comparison"), (tmp_path / "foreign", "does not belong to a run")):
        with pytest.raises(ValueError, match=said):
            qirf_vk.train(tmp_path, output=folder, overwrite=True)
    assert (tmp_path / "foreign" / "model.ply").read_text() == "of nobody"


def test_compression_and_scores_are_the_programs(trained, scene, tmp_path):
    model = trained.model
    model.save(tmp_path / "model.ply")
    for selector in ["pairs", "gnso", "lowdin"]:
        small, record = qirf_vk.compress(model, 0.5, selector=selector, views=8, picture_size=(64, 64))
        small.save(tmp_path / "python.ply")
        options = ["--keep", 0.5, "--selector", selector, "--views", 8, "--size", "64x64"]
        program("compress", tmp_path / "model.ply", "-o", tmp_path / "program.ply", *options)
        assert (tmp_path / "python.ply").read_bytes() == (tmp_path / "program.ply").read_bytes(), selector
        assert record["output"]["gaussians"] == len(small)
    rule = {"selector": "css", "budget": "global", "detail": 0.1, "merge": False}
    qirf_vk.compress(model, 0.5, **rule, views=8, picture_size=(64, 64))[0].save(tmp_path / "python.ply")
    options = ["--keep", 0.5, "--views", 8, "--size", "64x64", "--selector", "css", "--budget", "global", "--detail", 0.1, "--merge=false"]
    program("compress", tmp_path / "model.ply", "-o", tmp_path / "program.ply", *options)
    assert (tmp_path / "python.ply").read_bytes() == (tmp_path / "program.ply").read_bytes()
    exact, _ = qirf_vk.compress(model, count=50, views=8, picture_size=(64, 64))
    assert len(exact) == 50
    fitted, record = qirf_vk.compress(model, size=4000, output=tmp_path / "s.spz", views=8, picture_size=(64, 64))
    assert (tmp_path / "s.spz").stat().st_size <= 4000 and len(fitted) == record["output"]["gaussians"]
    half = (tmp_path / "model.ply").stat().st_size // 2
    fitted, record = qirf_vk.compress(model, size=half, views=8, picture_size=(64, 64))
    fitted.save(tmp_path / "half.ply")
    assert 0.9 * half < (tmp_path / "half.ply").stat().st_size <= half and record["aim"] is not None
    scores = qirf_vk.evaluate(model, scene)
    assert scores["test"]["psnr"] == pytest.approx(trained.record["test"]["psnr"], abs=1e-4)
    against = qirf_vk.evaluate(small, against=model)
    assert against["test"]["psnr"] > 10 and len(against["views"]) > 0


def test_an_exception_of_a_callback_ends_the_run(scene, tmp_path):
    def fails(step):
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        qirf_vk.train(scene, iterations=400, output=tmp_path / "run", on_step=fails)
    assert (tmp_path / "run" / "checkpoint.safetensors").exists()


def test_exceptions_while_notes_and_scores_are_written_are_passed_on(scene, trained, monkeypatch):
    def fails(stage, done, total):
        if stage == "scores":
            raise ZeroDivisionError(stage)

    for call in (
        lambda: qirf_vk.train(scene, iterations=10, prune=False, on_progress=fails),
        lambda: qirf_vk.evaluate(trained.model, scene, on_progress=fails),
    ):
        with pytest.raises(ZeroDivisionError, match="scores"):
            call()

    usual = logging.getLogger

    def interrupted(name=None):
        if name == "qirf_vk":
            raise KeyboardInterrupt
        return usual(name)

    monkeypatch.setattr("logging.getLogger", interrupted)
    with pytest.raises(KeyboardInterrupt):
        qirf_vk.train(scene, iterations=40)


def test_styles_of_training_are_those_of_scoring(scene):
    style = {"antialias": True, "dilation": 0.3, "depth_order": True}
    run = qirf_vk.train(scene, iterations=40, prune=False, **style)
    for given in (style, {}):
        assert qirf_vk.evaluate(run.model, scene, **given)["test"]["psnr"] == pytest.approx(run.record["test"]["psnr"], abs=1e-4)
    camera = qirf_vk.orbit(run.model, 1, size=[32, 24])[0]
    pictures = [qirf_vk.Renderer(run.model, **given).render(camera) for given in ({}, {"dilation": 0.1}, {"antialias": False})]
    assert not np.array_equal(pictures[0], pictures[1]) and not np.array_equal(pictures[0], pictures[2])
    with pytest.raises(ValueError, match="dilation"):
        qirf_vk.Renderer(run.model, dilation=-1.0)


def test_what_is_lost_is_warned_of(ring, tmp_path):
    ring.save(tmp_path / "whole.ply")
    data = bytearray((tmp_path / "whole.ply").read_bytes())
    at = data.index(b"end_header\n") + len(b"end_header\n")
    data[at:at + 4] = np.float32(np.nan).tobytes()
    (tmp_path / "damaged.ply").write_bytes(data)
    with pytest.warns(UserWarning, match="1 Gaussian removed"):
        assert len(qirf_vk.Model.load(tmp_path / "damaged.ply")) == len(ring) - 1
    with pytest.warns(UserWarning, match="damaged.ply: .*1 Gaussian removed"), pytest.raises(TypeError, match="on_step"):
        qirf_vk.train(tmp_path, init=tmp_path / "damaged.ply", on_step=3)
    far = qirf_vk.Model.from_arrays(*arrays(ring), origin=(1e6, 0, 0))
    near = qirf_vk.Model.from_arrays(*arrays(ring), origin=(0, 1e6, 0))
    with pytest.warns(UserWarning, match="rounded to about"):
        qirf_vk.merge([near, far])


def test_a_near_plane_of_ones_own(ring):
    small = ring.scale(1e-3)
    camera = qirf_vk.orbit(small, 1, size=(32, 24))[0]
    renderer = qirf_vk.Renderer(small)
    right = renderer.render(camera)
    assert right[..., 3].max() > 0.1 and camera.near < 0.2 and len(camera.centre) == 3
    given = (camera.K, camera.world_to_camera, camera.size)
    assert not renderer.render(*given)[..., 3].any()
    assert np.array_equal(renderer.render(*given, near=camera.near), right)
    assert np.array_equal(renderer.render(qirf_vk.Camera(*given, near=camera.near)), right)


def test_ctrl_c_leaves_a_checkpoint_and_the_run_goes_on(scene, tmp_path):
    out = tmp_path / "run"
    # Processes that a shell starts in the background ignore SIGINT, and so do their children.
    heard = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{heard}; import qirf_vk; qirf_vk.train({str(scene)!r}, iterations=4000, output={str(out)!r}, prune=False)"
    child = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE)
    while not (out / "log.jsonl").exists() or not (out / "log.jsonl").read_text():
        assert child.poll() is None
        time.sleep(0.05)
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=30)
    assert b"KeyboardInterrupt" in said and (out / "checkpoint.safetensors").exists()


def test_other_threads_run_meanwhile(scene):
    ticks, done = [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.005)

    thread = threading.Thread(target=tick)
    thread.start()
    qirf_vk.train(scene, iterations=60, prune=False)
    done.set()
    thread.join()
    assert len(ticks) > 20


def test_import_is_quick():
    code = "import time; t = time.perf_counter(); import qirf_vk; print(time.perf_counter() - t)"
    seconds = [float(subprocess.check_output([sys.executable, "-c", code])) for _ in range(3)]
    assert min(seconds) < 0.05, seconds


def test_the_wheel_names_the_crates_inside_with_their_licences():
    licences = next(file for file in metadata.files("qirf-vk") if file.name == "THIRD-PARTY").read_binary()
    assert b"\npyo3 0." in licences and b"\nexr " in licences and b"\nqirf-vk" not in licences
    assert licences.count(b"Permission is hereby granted") > 10


def test_classes_are_final_as_the_stubs_say():
    for node in ast.parse((ROOT / "python" / "qirf_vk.pyi").read_text()).body:
        if isinstance(node, ast.ClassDef) and node.name != "DeviceError":
            assert [decorator.id for decorator in node.decorator_list] == ["final"], node.name
            with pytest.raises(TypeError, match="not an acceptable base type"):
                type("Own", (getattr(qirf_vk, node.name),), {})


def test_the_stubs_name_what_there_is():
    stubs = (ROOT / "python" / "qirf_vk.pyi").read_text()
    exported = next(n for n in ast.parse(stubs).body if isinstance(n, ast.Assign) and n.targets[0].id == "__all__")
    assert sorted(ast.literal_eval(exported.value)) == sorted(qirf_vk.__all__)
    for name in (name for name in dir(qirf_vk) if not name.startswith("_") and name != "qirf_vk"):
        assert f"class {name}" in stubs or f"def {name}(" in stubs, name
        for member in vars(getattr(qirf_vk, name)) if isinstance(getattr(qirf_vk, name), type) else ():
            assert member.startswith("_") or f"def {member}(" in stubs, f"{name}.{member}"
