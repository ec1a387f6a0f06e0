"""Tests of what Python expects of objects: indexing, pickles, weak references, signatures, warnings, threads and forks."""
import ast
import copy
import inspect
import json
import os
import pickle
import subprocess
import sys
import threading
import warnings
import weakref

import numpy as np
import pytest
import qirf_vk
from conftest import PROGRAM, RING, ROOT, arrays


def test_select_is_numpys(ring):
    n, means = len(ring), ring.means
    mask = means[:, 0] > 0
    for chosen in (mask, mask.tolist(), [0, -1, 3, 3], np.array([5, 2], "u1"), slice(None, None, 3), slice(-4, -1), slice(9, 2, -2), []):
        expected = means[chosen] if len(means[chosen]) else means[:0]
        assert np.array_equal(ring.select(chosen).means, expected), chosen
    for mask in (np.zeros((n, 3), bool), np.ones((n, 1), bool), np.ones(n + 1, bool), np.bool_(True)):
        shape = str(np.shape(mask)).replace("(", r"\(").replace(")", r"\)")
        with pytest.raises(ValueError, match=rf"a mask has the shape {shape}, and should have \({n},\)"):
            ring.select(mask)
    for indices in ([[0, 1]], 1):
        with pytest.raises(ValueError, match="indices have the shape"):
            ring.select(indices)
    with pytest.raises(TypeError, match="whole numbers"):
        ring.select([0.5])
    for beyond in (n, -n - 1):
        with pytest.raises(IndexError, match=f"no Gaussian {beyond} among {n}"):
            ring.select([0, beyond])


def test_paths_may_be_bytes(ring, tmp_path):
    ring.save(os.fsencode(tmp_path / "model.ply"))
    assert len(qirf_vk.Model.load(os.fsencode(tmp_path / "model.ply"))) == len(ring)


def test_models_without_gaussians_are_not_written(ring, tmp_path):
    with pytest.raises(ValueError, match="no Gaussian: nothing was written"):
        ring.select([]).save(tmp_path / "empty.ply")
    assert not list(tmp_path.iterdir())


def test_nested_lists_are_coefficients(ring):
    whole = np.concatenate(ring.sh, axis=1)
    for sh in (whole, whole.tolist(), ring.sh, tuple(ring.sh), [band.tolist() for band in ring.sh]):
        again = qirf_vk.Model.from_arrays(*arrays(ring)[:4], sh)
        assert all(np.array_equal(a, b) for a, b in zip(again.sh, ring.sh)) and again.degree == ring.degree


def test_records_have_true_numbers(ring, trained, scene, tmp_path):
    def bytes_of(model):
        (tmp_path / "own").mkdir(exist_ok=True)  # georeference.json is written beside models far from the origin
        model.save(tmp_path / "own" / "model.ply")
        return (tmp_path / "own" / "model.ply").stat().st_size

    small, record = qirf_vk.compress(ring, 0.5, views=4, picture_size=(48, 48))
    assert record["input"]["bytes"] == bytes_of(ring) and record["output"]["bytes"] == bytes_of(small)
    assert record["input"]["path"] is None and record["output"]["path"] is None
    _, record = qirf_vk.compress(ring, 0.5, output=tmp_path / "small.spz", views=4, picture_size=(48, 48))
    assert record["output"]["bytes"] == (tmp_path / "small.spz").stat().st_size
    assert record["input"]["bytes"] == bytes_of(ring) and record["output"]["path"] == str(tmp_path / "small.spz")
    far = qirf_vk.Model.from_arrays(*arrays(trained.model), origin=(5e5, 4e6, 0))
    assert qirf_vk.evaluate(trained.model, scene)["ply_bytes"] == bytes_of(trained.model) < bytes_of(far)
    record = qirf_vk.evaluate(small, against=ring)
    assert record["schema"] == 1 and record["gaussians"] == {"model": len(small), "original": len(ring)}
    small.save(tmp_path / "small.ply")
    command = [PROGRAM, "--quiet", "eval", tmp_path / "small.ply", "--against", RING, "--json"]
    theirs = json.loads(subprocess.check_output(command))
    assert list(record) == list(theirs) and record["test"]["psnr"] == pytest.approx(theirs["test"]["psnr"], abs=1e-4)
    assert qirf_vk.evaluate(ring, against=ring)["test"]["psnr"] is None


def test_models_and_cameras_are_pickled_and_copied(ring):
    model = qirf_vk.Model.from_arrays(*arrays(ring), antialiased=True, origin=(1.0, 2.0, 3.0))
    again = pickle.loads(pickle.dumps(model))
    for ours, theirs in zip([*arrays(model)[:4], *model.sh], [*arrays(again)[:4], *again.sh]):
        assert ours.tobytes() == theirs.tobytes()
    assert again.antialiased and again.origin == (1, 2, 3) and again.degree == model.degree
    camera = qirf_vk.orbit(ring, 1, size=(32, 24))[0]
    other = pickle.loads(pickle.dumps(camera))
    assert np.array_equal(other.K, camera.K) and np.array_equal(other.world_to_camera, camera.world_to_camera)
    assert other.size == camera.size and other.near == camera.near
    assert again != model and other != camera, "equality is identity"
    for thing in (model, camera):
        assert copy.copy(thing) is thing and copy.deepcopy([thing])[0] is thing


def test_up_may_have_any_length():
    expected = qirf_vk.Camera.look_at((0, 0, -3), up=(1, 1, 0)).world_to_camera
    for length in (1e200, 1e-200):
        assert np.allclose(qirf_vk.Camera.look_at((0, 0, -3), up=(length, length, 0)).world_to_camera, expected)


def test_weak_references_die_with_what_they_refer_to(ring):
    camera = lambda: qirf_vk.Camera.look_at((0, 0, -3), size=(8, 8))
    for make in (lambda: qirf_vk.Model.load(RING), qirf_vk.Device, lambda: qirf_vk.Renderer(ring), camera):
        thing = make()
        reference = weakref.ref(thing)
        assert reference() is thing
        del thing
        assert reference() is None


def test_representations_tell_what_things_are(ring, trained):
    assert repr(trained).startswith(f"Run(Model({len(trained.model)} Gaussians") and "PSNR" in repr(trained)
    renderer = repr(qirf_vk.Renderer(ring))
    assert renderer.startswith(f"Renderer({len(ring)} Gaussians, on ") and qirf_vk.Device().name in renderer
    assert repr(ring.select([0])).startswith("Model(1 Gaussian, ")
    for camera in [*qirf_vk.orbit(ring, 4), qirf_vk.Camera.look_at((0, 1e-300, -3))]:
        text = repr(camera)
        assert np.allclose(json.loads(text.split(" at ")[1][:-1]), camera.centre) and len(text) < 70 and "-0," not in text


def signature(node):
    """Names and defaults of a function of the stubs, without self and cls."""
    given = node.args
    names = [argument.arg for argument in given.args if argument.arg not in ("self", "cls")]
    defaults = [inspect.Parameter.empty] * (len(names) - len(given.defaults)) + [ast.literal_eval(d) for d in given.defaults]
    keywords = [(a.arg, ast.literal_eval(d)) for a, d in zip(given.kwonlyargs, given.kw_defaults)]
    return [*zip(names, defaults), *keywords, *([(given.kwarg.arg, inspect.Parameter.empty)] if given.kwarg else [])]


def test_stubs_have_the_real_signatures():
    checked = 0

    def check(thing, node):
        nonlocal checked
        real = [(p.name, p.default) for p in inspect.signature(thing).parameters.values() if p.name != "self"]
        assert real == signature(node), node.name
        checked += 1

    for node in ast.parse((ROOT / "python" / "qirf_vk.pyi").read_text()).body:
        if isinstance(node, ast.FunctionDef):
            check(getattr(qirf_vk, node.name), node)
        for member in node.body if isinstance(node, ast.ClassDef) else []:
            decorators = [d.id for d in getattr(member, "decorator_list", []) if isinstance(d, ast.Name)]
            if not isinstance(member, ast.FunctionDef) or "property" in decorators:
                continue
            if "overload" in decorators:  # a part of the real one
                real = list(inspect.signature(getattr(getattr(qirf_vk, node.name), member.name)).parameters)
                positions = [argument.arg for argument in member.args.args]
                assert positions == real[:len(positions)] and {a.arg for a in member.args.kwonlyargs} <= set(real)
            elif member.name == "__new__":
                check(getattr(qirf_vk, node.name), member)
            elif not member.name.startswith("__"):
                check(getattr(getattr(qirf_vk, node.name), member.name), member)
    assert checked > 20


def test_the_programs_warnings_are_warnings(ring, trained, scene, tmp_path):
    with pytest.warns(UserWarning, match="far from its origin: its positions are rounded to about"):
        far = ring.move_by((1e7, 0, 0))
    place = np.array([500_000.123, 4_100_000.37, 12])
    world = ring.means + place
    with pytest.warns(UserWarning, match="rounded to about .*; give means - c with origin=c"):
        qirf_vk.Model.from_arrays(world, *arrays(ring)[1:])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.allclose(qirf_vk.Model.from_arrays(world - place, *arrays(ring)[1:], origin=place).means, ring.means, atol=1e-6)
        far.turn((0, 0, 1), 30)
        ring.move_by((1, 0, 0))
    smooth = qirf_vk.Model.from_arrays(*arrays(ring), antialiased=True)
    with pytest.warns(UserWarning, match="they are drawn so; antialias=True or antialias=False draws both alike"):
        assert qirf_vk.evaluate(smooth, against=ring)["test"]["psnr"] is not None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert qirf_vk.evaluate(smooth, against=ring, antialias=False)["test"]["psnr"] is None
    with pytest.warns(UserWarning, match="no file tried in this format reaches 99 dB"):
        qirf_vk.compress(trained.model, psnr=99, output=tmp_path / "x.sog", views=4, picture_size=(64, 48))
    moved = trained.model.move_by((0.8, 0.3, 0))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        removed = len(moved) - len(moved.remove("floaters", scene=scene))
    assert any("far more than usual" in str(w.message) for w in told) == (removed > 0.05 * len(moved))


def test_callbacks_are_called_in_the_callers_thread_with_rising_counts(scene):
    told, threads = [], set()

    def progress(stage, done, total):
        told.append((stage, done, total))
        threads.add(threading.get_ident())

    def step(line):
        threads.add(threading.get_ident())

    run = qirf_vk.train(scene, iterations=40, on_progress=progress, on_step=step)
    qirf_vk.compress(run.model, psnr=30, views=4, picture_size=(64, 48), on_progress=progress)
    assert threads == {threading.get_ident()} and ("photos", 9, 9) in told
    assert all(0 <= done <= total for _, done, total in told)
    for (stage, before, _), (following, now, _) in zip(told, told[1:]):
        assert stage != following or before <= now, (stage, before, now)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_forked_child_is_told_instead_of_waiting():
    begin = f"import os, qirf_vk\nload = lambda: qirf_vk.Model.load({str(RING)!r})\n"
    end = """
child = os.fork()
if child == 0:
    try:
        (model or load()).move_by((1, 0, 0))
    except RuntimeError as e:
        os._exit(7 if "spawn" in str(e) else 1)
    os._exit(0)
print(os.WEXITSTATUS(os.waitpid(child, 0)[1]))
"""
    for model, expected in (("load()", b"7"), ("None", b"0")):
        code = f"{begin}model = {model}{end}"
        said = subprocess.run([sys.executable, "-W", "ignore", "-c", code], stdout=subprocess.PIPE, check=True, timeout=60).stdout
        assert said.strip() == expected, model


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_forked_child_drops_its_parents_renderer():
    # By os._exit, as the children of multiprocessing: exit handlers of llvmpipe join threads that do not exist in the child.
    code = f"""
import os, signal, sys, qirf_vk
renderer, device = qirf_vk.Renderer(qirf_vk.Model.load({str(RING)!r})), qirf_vk.Device()
if os.fork() == 0:
    signal.alarm(20)  # ends a child that waits
    del renderer, device
    os._exit(5)
sys.exit(0 if os.waitstatus_to_exitcode(os.wait()[1]) == 5 else 1)
"""
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True, timeout=60)


def test_masks_and_complex_numbers_are_not_dropped(ring):
    masked = np.ma.masked_greater(ring.means, 0)
    rows = [np.ma.masked_array(row, mask=[i == 5, False, False]) for i, row in enumerate(ring.means)]
    make = qirf_vk.Model.from_arrays
    assert np.array_equal(make(rows[:5], *arrays(ring.select(slice(5)))[1:]).means, ring.means[:5])
    for call in (lambda: make(masked, *arrays(ring)[1:]), lambda: make(rows, *arrays(ring)[1:]), lambda: ring.select(np.ma.masked_greater([0, 1], 0))):
        with pytest.raises(ValueError, match="(means|chosen) is masked: fill it, or leave out"):
            call()
    assert len(ring.select(np.ma.masked_greater([0, 1], 5))) == 2
    for call in (lambda: qirf_vk.Model.from_arrays(ring.means + 0j, *arrays(ring)[1:]), lambda: ring.transform(np.eye(4) + 0j)):
        with pytest.raises(TypeError, match="(means|matrix) has complex numbers: give real ones"):
            call()


def test_refusals_tell_what_was_given(ring, tmp_path):
    K, pose = np.diag([9, 9, 1]), np.eye(4)
    wrong = {
        r'ratio is for kind="needles", not for "invisible"': lambda: ring.remove("invisible", ratio=3),
        "near=1e-50: give": lambda: qirf_vk.Camera(K, pose, (4, 4), near=1e-50),
        "near=1e39: give": lambda: qirf_vk.Renderer(ring).render(K, pose, (4, 4), near=1e39),
        "size has 1 number:": lambda: qirf_vk.Camera(K, pose, [4]),
        r"a\\0b.ply.*: embedded null byte": lambda: qirf_vk.Model.load("a\0b.ply"),
        "init=.*: embedded null byte": lambda: qirf_vk.train(tmp_path, init="a\0b.ply"),
        r"world_to_camera has the shape \(3, 3\), and should have \(3, 4\) or \(4, 4\)": lambda: qirf_vk.Camera(K, np.eye(3), (4, 4)),
    }
    for text, call in wrong.items():
        with pytest.raises(ValueError, match=text):
            call()
    for shape in ((2, 6), (6, 2), (1, 4, 4), (12,), (16,)):
        with pytest.raises(ValueError, match=r"matrix has the shape .*, and should have \(3, 4\) or \(4, 4\)"):
            ring.transform(np.zeros(shape))
    assert np.array_equal(ring.transform(pose[:3]).means, ring.means)
    with pytest.raises(MemoryError, match="hold no part of a model: give another device, or a larger memory_limit"):
        qirf_vk.Renderer(ring, qirf_vk.Device(memory_limit=100_000))
    with pytest.raises(MemoryError, match="give a smaller size"):
        qirf_vk.Renderer(ring).render(K, pose, (65536, 65536))
