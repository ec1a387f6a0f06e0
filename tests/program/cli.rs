//! The program as a user runs it: every command, every exit code, and bad input of every kind.

mod commands;
mod doctor;
mod kernels;
mod pages;
mod refusals;
mod render;
mod tags;
mod tuning;
mod wording;

use super::ended::{Ended, content, end, qirf};
use qirf_vk::gaussians::{Gaussians, formats};
use std::fs;
use std::path::PathBuf;
use std::process::Command;
use tempfile::TempDir;

/// A folder with a small model, a small scene without photos, and the program.
pub(super) struct Sandbox {
    folder: TempDir,
}

impl Sandbox {
    pub(super) fn new() -> Self {
        let sandbox = Self { folder: tempfile::tempdir().unwrap() };
        formats::write(&sandbox.path("model.ply"), &model(20), formats::RenderMode::Plain).unwrap();
        sandbox.scene("scene", "1 PINHOLE 40 30 35 35 20 15", &["b/two.png", "one.jpg"]);
        sandbox
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A COLMAP text model, its cameras four units before the origin.
    pub(super) fn scene(&self, name: &str, camera: &str, images: &[&str]) -> PathBuf {
        let folder = self.path(name).join("sparse/0");
        fs::create_dir_all(&folder).unwrap();
        let lines: Vec<String> = (1..).zip(images).map(|(i, n)| format!("{i} 1 0 0 0 0.1 0 4 1 {n}\n\n")).collect();
        fs::write(folder.join("cameras.txt"), format!("{camera}\n")).unwrap();
        fs::write(folder.join("images.txt"), lines.concat()).unwrap();
        fs::write(folder.join("points3D.txt"), "1 0 0 0 10 20 30 0.5 1 0\n").unwrap();
        self.path(name)
    }

    /// The program in the folder.
    pub(super) fn command(&self, arguments: &[&str]) -> Command {
        let mut command = qirf(arguments);
        command.current_dir(self.folder.path());
        command
    }

    /// Runs the program in the folder.
    #[track_caller]
    pub(super) fn run(&self, arguments: &[&str]) -> Ended {
        end(&mut self.command(arguments))
    }

    /// Runs the program, which must end with this exit code and a message that contains all of `says`.
    #[track_caller]
    pub(super) fn fails(&self, code: i32, arguments: &[&str], says: &[&str]) {
        self.run(arguments).with(code, &["error: "]).with(code, says);
    }

    /// Runs the program, which must succeed.
    #[track_caller]
    pub(super) fn works(&self, arguments: &[&str]) -> Ended {
        self.run(arguments).with(0, &[])
    }

    /// Like [`Self::works`], under validation layers.
    #[track_caller]
    pub(super) fn validated(&self, arguments: &[&str]) -> Ended {
        end(self.command(arguments).env("QIRF_VALIDATION", "1")).with(0, &[])
    }

    /// Converts a model without measuring the loss, for which many pictures are drawn: there is no such device.
    #[track_caller]
    pub(super) fn converts(&self, arguments: &[&str]) -> Ended {
        self.works(&[&["convert", "--device", "no such device"], arguments].concat())
    }

    /// Every file with its content.
    pub(super) fn content(&self) -> Vec<(PathBuf, Vec<u8>)> {
        content(self.folder.path())
    }
}

pub(super) fn model(n: usize) -> Gaussians {
    Gaussians {
        means: (0..n).map(|i| [(i as f32).sin(), (i as f32).cos(), 0.01 * i as f32]).collect(),
        log_scales: vec![[-1.5, -2.0, -1.8]; n],
        rotations: vec![[0.9, 0.1, 0.3, -0.2]; n],
        opacity_logits: vec![1.5; n],
        sh: vec![vec![0.7; n * 3], vec![0.05; n * 9]],
    }
}
