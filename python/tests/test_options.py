"""Tests of keyword arguments: the keys of config.toml, short forms, and messages in Python's terms."""
import os

import numpy as np
import pytest
import qirf_vk
from conftest import arrays, program


def same(a, b):
    return (a / "model.ply").read_bytes() == (b / "model.ply").read_bytes()


def test_a_run_is_repeated_from_its_own_config(scene, tmp_path):
    tomllib = pytest.importorskip("tomllib")
    first, again = tmp_path / "first", tmp_path / "again"
    run = qirf_vk.train(scene, "quick", iterations=40, keep=0.4, schedule="one-shot", sh_degree=1, output=first)
    config = tomllib.loads((first / "config.toml").read_text())
    qirf_vk.train(**config, output=again)
    assert same(first, again) and (first / "config.toml").read_text() == (again / "config.toml").read_text()
    assert qirf_vk.train(**config, output=first, resume=True).record == run.record
    for key in ("schedule", "prune", "effects"):
        table = qirf_vk.train(scene, "quick", **{"iterations": 40, "sh_degree": 1, "output": tmp_path / key, key: config[key]})
        assert table.log[-1]["iterations"] == 40
    assert tomllib.loads((tmp_path / "prune" / "config.toml").read_text())["prune"] == config["prune"]


def test_short_forms_are_the_programs(scene, tmp_path):
    program("run", scene, "-o", tmp_path / "program", "--iterations", 60, "--schedule", "gradual", "--target-count", 90, "--effect", "exposure=on")
    for name, effects in (("list", ["exposure=on"]), ("dict", {"exposure": "on"}), ("bool", {"exposure": True}), ("text", "exposure=on")):
        qirf_vk.train(scene, iterations=60, schedule="gradual", count=90, effects=effects, output=tmp_path / name)
        assert same(tmp_path / name, tmp_path / "program"), name
    partial = qirf_vk.train(scene, schedule={"iterations": 30, "growth": None}, prune=False)
    assert partial.log[-1]["iterations"] == 30 and partial.record["prunes"] == []
    selected = qirf_vk.train(scene, iterations=40, prune={"compression": {"selector": "importance", "keep": {"count": 50}}})
    assert len(selected.model) <= 50 and selected.record["prunes"][0]["selector"] == "importance"


def test_a_run_begins_with_a_model(scene, trained, tmp_path):
    tomllib = pytest.importorskip("tomllib")
    options = {"iterations": 20, "prune": False}
    trained.model.save(tmp_path / "start.ply")
    qirf_vk.train(scene, init=tmp_path / "start.ply", output=tmp_path / "path", **options)
    qirf_vk.train(scene, init=trained.model, output=tmp_path / "model", **options)
    program("run", scene, "-o", tmp_path / "program", "--iterations", 20, "--no-prune", "--init", tmp_path / "start.ply")
    assert same(tmp_path / "path", tmp_path / "program") and same(tmp_path / "model", tmp_path / "program")
    assert tomllib.loads((tmp_path / "model" / "config.toml").read_text())["init"] == {"model": "initial.ply"}
    smooth = qirf_vk.Model.from_arrays(*arrays(trained.model), antialiased=True)
    assert qirf_vk.train(scene, init=smooth, **options).model.antialiased
    with pytest.raises(ValueError, match="init was another model"):
        qirf_vk.train(scene, init=trained.model.select(slice(5)), output=tmp_path / "model", resume=True, **options)


def test_an_initial_model_has_the_degree_that_is_asked_for(scene, trained, tmp_path):
    flat = trained.model.with_degree(0)
    bands = [*flat.sh, *(np.zeros((len(flat), 2 * l + 1, 3)) for l in (1, 2, 3))]
    options = {"init": qirf_vk.Model.from_arrays(*arrays(flat)[:4], bands), "iterations": 3, "prune": False}
    for asked, degree in (({"sh_degree": 0}, 0), ({"sh_degree": 1}, 1), ({"effects": {"view_dependence": False}}, 0)):
        assert qirf_vk.train(scene, **options, **asked).model.degree == degree, asked
    kept = qirf_vk.train(scene, output=tmp_path, **options)
    decision = next(effect for effect in kept.record["effects"] if effect["name"] == "view_dependence")
    assert kept.model.degree == decision["degree"] == 3
    assert "\nsh_degree = 3\n" in (tmp_path / "config.toml").read_text()


def test_contradictions_are_named(tmp_path):
    wrong = {
        r"iterations=30 contradicts schedule=": {"iterations": 30, "schedule": {"iterations": 10}},
        r"antialias=True contradicts effects=": {"antialias": True, "effects": {"antialias": "off"}},
        r"sh_degree=0 contradicts effects=": {"sh_degree": 0, "effects": ["view_dependence=on"]},
        r'schedule="gradual" and a dict as prune': {"schedule": "gradual", "prune": {"l2": 1.0}},
        r'prune=False contradicts schedule="gradual"': {"schedule": "gradual", "prune": False},
        r"prune=False keeps all": {"prune": False, "keep": 0.5},
        r"keep and count contradict prune": {"keep": 0.5, "prune": {"compression": {"keep": {"count": 7}}}},
        r"two numbers of Gaussians": {"keep": 0.5, "count": 7},
    }
    for text, options in wrong.items():
        with pytest.raises(ValueError, match=text):
            qirf_vk.train(tmp_path, **options)


def test_messages_are_in_pythons_terms(tmp_path):
    wrong = {
        "iterations is 30.0, a whole number is needed": {"iterations": 30.0},
        "seed is True, a whole number is needed": {"seed": True},
        "clean is \"x\", True or False is needed": {"clean": "x"},
        "antialias is \"on\", True or False is needed": {"antialias": "on"},
        "dilation is \"x\", a number is needed": {"dilation": "x"},
        "images is 3, a string is needed": {"images": 3},
        "tuning is \"gpu\", a dict is needed": {"tuning": "gpu"},
        "schedule.position_rate is \"x\", a number is needed": {"schedule": {"position_rate": "x"}},
        "schedule has a key \"foo\" that is not known: its keys are \"iterations\"": {"schedule": {"foo": 1}},
        "prune.l2 is \"x\", a number is needed": {"prune": {"l2": "x"}},
        "iterations=0: give a number from 1": {"iterations": 0},
        "schedule.iterations = 0: give a number from 1": {"schedule": {"iterations": 0}},
        "count=1000000000: give a number from 1 to 28000000": {"count": 10**9},
        "resolution=0: give a width in pixels": {"resolution": 0},
        'resolution="64x48": give a width in pixels': {"resolution": "64x48"},
        r"background=\(2, 0, 0\): give red, green and blue": {"background": (2, 0, 0)},
        "seed=nan: give finite numbers": {"seed": float("nan")},
        r"effects=\{'a'\}: give a number, a text, a path, a list or a dict": {"effects": {"a"}},
        'schedule="often": give "attrition"': {"schedule": "often"},
        'preset is "fast": give one of "paper"': {"preset": "fast"},
        "background is .*, a list of three numbers is needed": {"background": (1, 2)},
        "output is an empty path": {"output": ""},
    }
    for text, options in wrong.items():
        with pytest.raises(ValueError, match=text) as error:
            qirf_vk.train(tmp_path, **options)
        assert not any(word in str(error.value) for word in ("u32", "expected", "struct", "--", "serde")), error.value
    unknown = {
        "resolutoin: did you mean resolution?": {"resolutoin": 3},
        "target_count: did you mean count?": {"target_count": 3},
        "grow_to: did you mean schedule=": {"grow_to": 500},
        "no_prune: did you mean prune=False": {"no_prune": True},
        "report: train writes no report": {"report": False},
        "train has no keyword xyzzy; it has scene, images": {"xyzzy": 1},
    }
    for text, options in unknown.items():
        with pytest.raises(TypeError) as error:
            qirf_vk.train(tmp_path, **options)
        assert text in str(error.value)
    assert not list(tmp_path.iterdir()), "nothing was written"


def test_options_of_the_program_are_arguments(ring, scene, tmp_path):
    small = {"views": 4, "picture_size": (48, 48)}
    with pytest.raises(ValueError, match='give size="[0-9]+B" or more') as error:
        qirf_vk.compress(ring, size=10, **small)
    least = str(error.value).split('size="')[1].split('"')[0]
    assert len(qirf_vk.compress(ring, size=least, **small)[0]) == 1
    assert len(qirf_vk.compress(ring, size=int(least[:-1]), **small)[0]) == 1
    for size in ("5", "0MB", "5 apples", "nanMB"):
        with pytest.raises(ValueError, match="size=.*give a number of bytes, or a text such as"):
            qirf_vk.compress(ring, size=size)
    with pytest.raises(ValueError, match='size and psnr need selector="pairs"'):
        qirf_vk.compress(ring, size="50kB", selector="opacity", **small)
    with pytest.raises(ValueError, match="9 photos; lower least"):
        ring.crop_views(scene, least=100)

    def ends(step):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        qirf_vk.train(scene, iterations=400, output=tmp_path / "run", on_step=ends)
    with pytest.raises(ValueError, match="give resume=True to go on with it"):
        qirf_vk.train(scene, iterations=400, output=tmp_path / "run")


def test_photos_are_chosen_everywhere(trained, scene, tmp_path):
    model = trained.model
    os.rename(scene / "images", scene / "others")
    try:
        given = {"images": "others"}
        assert qirf_vk.evaluate(model, scene, **given)["test"]["psnr"] == pytest.approx(trained.record["test"]["psnr"], abs=1e-4)
        assert len(model.crop_views(scene, **given)) > 0 and len(model.remove("floaters", scene=scene, **given)) > 0
        options = {"antialias": True, "dilation": 0.3, "background": (1, 0, 0), "eval_every": 3, "exposure": True}
        smaller, record = qirf_vk.compress(model, 0.5, scene=scene, **given, **options)
        smaller.save(tmp_path / "python.ply")
        model.save(tmp_path / "model.ply")
        asked = ["--antialias", "--dilation", 0.3, "--background", "1,0,0", "--eval-every", 3, "--images", "others", "--keep", 0.5]
        program("compress", tmp_path / "model.ply", "-o", tmp_path / "program.ply", "--scene", scene, *asked)
        assert (tmp_path / "python.ply").read_bytes() == (tmp_path / "program.ply").read_bytes() and smaller.antialiased
        assert record["protocol"]["test_views"] == 3 and record["protocol"]["background"] == [1, 0, 0]
        assert "affine" in record["protocol"]["exposure"]
    finally:
        os.rename(scene / "others", scene / "images")
    for call in (lambda: qirf_vk.compress(model, images="others"), lambda: model.remove("floaters", images="others")):
        with pytest.raises(ValueError, match="images is of a scene's photos"):
            call()


def test_cameras_are_given_by_K(ring):
    camera = qirf_vk.orbit(ring, 1, size=(32, 24))[0]
    renderer = qirf_vk.Renderer(ring)
    parts = {"K": camera.K, "world_to_camera": camera.world_to_camera, "size": camera.size}
    expected = renderer.render(qirf_vk.Camera(camera.K, camera.world_to_camera, camera.size))
    assert np.array_equal(renderer.render(qirf_vk.Camera(**parts)), expected)
    assert np.array_equal(renderer.render(**parts), expected) and np.isfinite(renderer.depth(**parts)).any()
    with pytest.raises(TypeError, match="world_to_camera.*size"):
        qirf_vk.Camera(camera.K)
    with pytest.raises(TypeError, match="'k'"):
        qirf_vk.Camera(**parts, k=camera.K)
    with pytest.raises(ValueError, match="give a Camera, or K"):
        renderer.render(camera, K=camera.K)
    assert qirf_vk.Device(0).name == qirf_vk.Device("0").name == qirf_vk.Device.list()[0]
