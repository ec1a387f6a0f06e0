"""Tests of what models remember of their runs, of the cameras of scenes, and of what is told when something is lost."""
import copy
import json
import logging
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
import qirf_vk
from conftest import arrays, program


def told(caplog, level):
    return [record.getMessage() for record in caplog.records if record.levelname == level]


def are_the_programs(renderer, views, folder):
    for view in views:
        expected = np.load(folder / f"{Path(view.name).stem}.npy")
        picture = renderer.render(view.camera)
        assert picture[..., :expected.shape[2]].tobytes() == expected.tobytes(), view


def test_models_remember_how_their_run_draws_and_scores_them(scene, tmp_path, caplog):
    style = {"dilation": 0.1, "depth_order": True, "background": [1, 0, 0], "effects": ["exposure=on"]}
    run = qirf_vk.train(scene, iterations=40, output=tmp_path / "run", **style)
    file = tmp_path / "run" / "model.ply"
    copies = [pickle.loads(pickle.dumps(run.model)), run.model.select(slice(None)), copy.copy(run.model), qirf_vk.merge([run.model])]
    psnr = pytest.approx(run.record["test"]["psnr"], abs=1e-4)
    for model in (run.model, qirf_vk.Model.load(file), *copies):
        assert qirf_vk.evaluate(model, scene)["test"]["psnr"] == psnr
    for model, given in ((run.model, {"exposure": False}), (qirf_vk.Model.from_arrays(*arrays(run.model)), {})):
        assert qirf_vk.evaluate(model, scene, **given)["test"]["psnr"] != psnr
    caplog.set_level(logging.INFO, logger="qirf_vk")
    renderer = qirf_vk.Renderer(run.model)
    assert "drawn with dilation=0.1, depth_order=True, as in the model's run" in told(caplog, "INFO")
    assert "drawn on background=(1.000, 0.000, 0.000), as in the model's run" in told(caplog, "INFO")
    program("render", file, "--scene", scene, "--format", "npy", "-o", tmp_path / "pictures")
    are_the_programs(renderer, qirf_vk.cameras(scene), tmp_path / "pictures")
    program("compress", file, "-o", tmp_path / "program.ply", "--keep", 0.5, "--scene", scene)
    qirf_vk.compress(run.model, 0.5, scene=scene)[0].save(tmp_path / "python.ply")
    assert (tmp_path / "python.ply").read_bytes() == (tmp_path / "program.ply").read_bytes()
    assert "an exposure is fitted to each photo, as in the model's run" in told(caplog, "INFO")
    (tmp_path / "run" / "config.toml").write_text("broken")
    with pytest.warns(UserWarning, match="the style of rendering and exposures are not taken from it"):
        qirf_vk.Model.load(file)


def test_cameras_of_a_scene_are_those_of_scores(scene, trained, tmp_path, caplog):
    views = qirf_vk.cameras(scene, resolution="/2")
    record = qirf_vk.evaluate(trained.model, scene, resolution="/2")
    assert [view.name for view in views if view.held_out] == [score["name"] for score in record["views"]]
    assert len(views) == 9 and {view.camera.size for view in views} == {(24, 18)}
    assert not any(view.held_out for view in qirf_vk.cameras(scene, eval_every=0))
    trained.model.save(tmp_path / "model.ply")
    program("render", tmp_path / "model.ply", "--scene", scene, "--resolution", "/2", "--format", "npy", "-o", tmp_path / "pictures")
    are_the_programs(qirf_vk.Renderer(trained.model, background=(0, 0, 0)), views, tmp_path / "pictures")
    shutil.copytree(scene, tmp_path / "scene")
    (tmp_path / "scene" / "images" / views[3].name).unlink()
    (tmp_path / "scene" / "sparse" / "0" / "test.txt").write_text(views[0].name)
    caplog.set_level(logging.INFO, logger="qirf_vk")
    with pytest.warns(UserWarning, match="scene: 1 photo listed but absent") as losses:
        assert len(qirf_vk.cameras(tmp_path / "scene")) == 8
    assert len(losses) == 1 and any("scene: 1 photo held out, as " in line for line in told(caplog, "INFO"))


def test_a_place_that_is_not_recorded_is_warned_of(scene, trained, tmp_path):
    views = qirf_vk.cameras(scene)
    K, (width, height) = views[0].camera.K, views[0].camera.size
    frames = []
    for view in views:
        pose = np.linalg.inv(view.camera.world_to_camera) @ np.diag([1, -1, -1, 1])
        pose[:3, 3] += (5e5, 4e6, 0)
        frames.append({"file_path": f"images/{view.name}", "transform_matrix": pose.tolist()})
    lens = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "w": width, "h": height}
    far = tmp_path / "far"
    shutil.copytree(scene / "images", far / "images")
    (far / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    assert all(np.abs(view.camera.centre).max() < 1e4 for view in qirf_vk.cameras(far)), "about the local origin"
    trained.model.save(tmp_path / "model.spz")
    model = qirf_vk.Model.load(tmp_path / "model.spz")
    copies = [model, pickle.loads(pickle.dumps(model)), qirf_vk.merge([trained.model, model])]
    calls = [lambda copied=copied: qirf_vk.evaluate(copied, far) for copied in copies]
    for call in (*calls, lambda: qirf_vk.compress(model, 0.5, scene=far)):
        with pytest.warns(UserWarning, match="the model records no local origin, so the capture's is assumed"):
            call()


def test_losses_are_warnings_of_the_log(scene, trained, tmp_path, caplog):
    shutil.copytree(scene, tmp_path / "scene")
    photo = tmp_path / "scene" / "images" / qirf_vk.cameras(scene)[1].name
    photo.write_bytes(photo.read_bytes()[:200])
    caplog.set_level(logging.INFO, logger="qirf_vk")
    qirf_vk.evaluate(trained.model, tmp_path / "scene")
    assert any("1 photo damaged" in line for line in told(caplog, "WARNING"))
    assert not any("damaged" in line for line in told(caplog, "INFO"))
