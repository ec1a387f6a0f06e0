//! `qirf-vk shard`: a compression in tasks has the bytes of the undivided one, whatever happens on the way.

use super::ended::{Ended, end, qirf, works};
use super::larger::ball;
use crate::support::{Random, documented};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Options of the compression: 34 views in three chunks, 6 held out.
const OPTIONS: [&str; 6] = ["--views", "40", "--size", "72x56", "--background", "0.1,0.2,0.3"];
/// A fingerprint that stands in for the device's, which takes seconds to compute.
pub(super) const FINGERPRINT: (&str, &str) = ("QIRF_FINGERPRINT", "0123");

/// A task's name, with the files that it needs and writes.
pub(super) type Listed = (String, Vec<String>, Vec<String>);

/// A folder with a model or a scene, and the bytes that the result has.
pub(super) struct Stage {
    folder: tempfile::TempDir,
    pub right: Vec<u8>,
}

impl Stage {
    /// An empty folder.
    pub fn empty() -> Self {
        Self { folder: tempfile::tempdir().unwrap(), right: Vec::new() }
    }

    fn new() -> Self {
        let stage = Self::empty();
        ball(stage.folder.path());
        Self { right: undivided().0.clone(), ..stage }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = qirf(arguments);
        command.env(FINGERPRINT.0, FINGERPRINT.1).current_dir(self.folder.path());
        command
    }

    #[track_caller]
    pub fn works(&self, arguments: &[&str]) -> Ended {
        works(&mut self.command(arguments))
    }

    /// Starts a command without waiting for it.
    pub fn start(&self, arguments: &[&str]) -> Child {
        self.command(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts")
    }

    fn plan(&self, folder: &str) -> Vec<Listed> {
        self.planned(folder, &[&["compress", "ball.ply"], &OPTIONS[..]].concat())
    }

    /// Plans a job into a folder; returns its tasks.
    pub fn planned(&self, folder: &str, job: &[&str]) -> Vec<Listed> {
        self.works(&[&["shard", "plan"], job, &["-o", folder]].concat());
        let text = fs::read(self.path(folder).join("tasks.json")).unwrap();
        let list: Value = serde_json::from_slice(&text).unwrap();
        documented("shard", &list);
        let names = |v: &Value| v.as_array().unwrap().iter().map(|n| n.as_str().unwrap().to_owned()).collect();
        let task = |t: &Value| (t["id"].as_str().unwrap().to_owned(), names(&t["needs"]), names(&t["outputs"]));
        list["tasks"].as_array().unwrap().iter().map(task).collect()
    }

    pub fn status(&self, folder: &str, id: &str) -> String {
        let list = self.works(&["shard", "status", folder, "--json"]).json();
        documented("shard", &list);
        let task = list["tasks"].as_array().unwrap().iter().find(|t| t["id"] == id).unwrap().clone();
        task["state"].as_str().unwrap().to_owned()
    }

    /// Does all tasks of a plan one by one in a random order that their needs allow.
    pub fn shuffled(
        &self,
        folder: &str,
        mut open: Vec<Listed>,
        seed: u64,
        prepare: impl Fn(&mut Command) -> &mut Command,
    ) {
        let mut random = Random(seed);
        while !open.is_empty() {
            let there = |need: &String| self.path(folder).join(need).exists();
            let ready: Vec<usize> = (0..open.len()).filter(|t| open[*t].1.iter().all(there)).collect();
            let next = ready[(random.unit() * ready.len() as f64) as usize];
            let (id, ..) = open.remove(next);
            works(prepare(&mut self.command(&["shard", "task", folder, &id])));
        }
        let list = self.works(&["shard", "status", folder, "--json"]).json();
        assert!(list["tasks"].as_array().unwrap().iter().all(|task| task["state"] == "done"), "{list:#}");
    }

    /// The result of a folder is that of the undivided compression.
    pub fn is_right(&self, folder: &str) {
        assert!(fs::read(self.path(folder).join("model.ply")).unwrap() == self.right, "{folder}");
    }

    pub fn refused(&self, code: i32, says: &[&str], arguments: &[&str]) {
        end(&mut self.command(arguments)).with(code, says);
    }
}

/// The bytes and the record of the undivided compression of the ball, made once.
fn undivided() -> &'static (Vec<u8>, Value) {
    static MADE: OnceLock<(Vec<u8>, Value)> = OnceLock::new();
    MADE.get_or_init(|| {
        let stage = Stage::empty();
        ball(stage.folder.path());
        let job = [&["compress", "ball.ply", "-o", "small.ply", "--json"], &OPTIONS[..]].concat();
        let record = stage.works(&job).json();
        (fs::read(stage.path("small.ply")).unwrap(), record)
    })
}

/// The figures of a divided compression to PLY are those of the whole, but for the scores of the file, which are those of the model.
#[track_caller]
fn same_figures(parts: &Value, whole: &Value) {
    let mut whole = whole.clone();
    whole["test"]["written"] = Value::Null;
    whole["views"].as_array_mut().unwrap().iter_mut().for_each(|view| view["written"] = Value::Null);
    for name in ["test", "views", "protocol"] {
        assert_eq!(parts[name], whole[name], "{name}");
    }
}

pub(super) fn flip(path: &Path, at: usize) {
    let mut bytes = fs::read(path).unwrap();
    bytes[at] ^= 16;
    fs::write(path, bytes).unwrap();
}

#[test]
fn tasks_in_any_order_have_the_bytes_of_the_whole() {
    let stage = Stage::new();
    let mut figures = Vec::new();
    for order in 0..2 {
        let folder = format!("order{order}");
        let tasks = stage.plan(&folder);
        assert_eq!(tasks.len(), 6, "{tasks:?}");
        // One of the orders on a device that draws in parts.
        let small = if order == 1 { "buffers=100000" } else { "" };
        stage.shuffled(&folder, tasks, 7 + order, |command| command.env("QIRF_LIMITS", small));
        stage.is_right(&folder);
        let bytes = fs::read(stage.path(&folder).join("metrics.json")).unwrap();
        let mut parts: Value = serde_json::from_slice(&bytes).unwrap();
        // One device has other limits.
        for name in ["device", "crc32"] {
            parts.as_object_mut().unwrap().remove(name).expect(name);
        }
        figures.push(parts);
    }
    let whole = &undivided().1;
    for parts in &figures {
        same_figures(parts, whole);
        assert_eq!(parts["prune"]["pairs"], whole["prune"]["pairs"]);
    }
    assert_eq!(figures[0], figures[1]);
}

/// The bytes of the whole also in a format that rounds values; scores are then those of the file.
#[test]
fn a_format_that_rounds_values_has_the_scores_of_its_file() {
    let stage = Stage::empty();
    ball(&stage.path(""));
    let job = ["compress", "ball.ply", "--views", "10", "--size", "40x30"];
    let whole = stage.works(&[&job[..], &["-o", "small.compressed.ply", "--json"]].concat()).json();
    stage.planned("p", &[&job[..], &["--name", "m.compressed.ply"]].concat());
    stage.works(&["shard", "all", "p"]);
    let read = |name: &str| fs::read(stage.path(name)).unwrap();
    assert!(read("p/m.compressed.ply") == read("small.compressed.ply"));
    let parts: Value = serde_json::from_slice(&read("p/metrics.json")).unwrap();
    assert!(parts["test"]["written"]["psnr"].is_number() && parts["test"]["pruned"].is_null(), "{}", parts["test"]);
    assert_eq!(parts["test"]["written"], whole["test"]["written"]);
    // Pictures would choose the precision.
    for name in ["m.spz", "m.sog"] {
        let says = [name, "by pictures", "`qirf-vk convert`"];
        stage.refused(2, &says, &["shard", "plan", "compress", "ball.ply", "-o", "q", "--name", name]);
    }
}

#[test]
fn killed_work_goes_on_and_copies_do_no_harm() {
    let stage = Stage::new();
    stage.plan("killed");
    let mut random = Random(3);
    for _ in 0..6 {
        let mut all = stage.start(&["shard", "all", "killed"]);
        std::thread::sleep(Duration::from_millis(150 + (900.0 * random.unit()) as u64));
        all.kill().unwrap();
        all.wait().unwrap();
    }
    // Two at once, each on all tasks.
    let copies = [stage.start(&["shard", "all", "killed"]), stage.start(&["shard", "all", "killed"])];
    let running = || stage.status("killed", "choose") == "running" || stage.status("killed", "report") == "done";
    let begun = Instant::now();
    while !running() && begun.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(50));
    }
    for mut copy in copies {
        assert!(copy.wait().unwrap().success());
    }
    stage.is_right("killed");
    let left: Vec<_> = fs::read_dir(stage.path("killed")).unwrap().flatten().map(|e| e.file_name()).collect();
    assert!(left.iter().all(|name| !name.to_string_lossy().starts_with('.')), "nothing half-written is left: {left:?}");
}

#[test]
fn damaged_and_foreign_parts_are_named_and_made_again() {
    let stage = Stage::new();
    stage.plan("a");
    stage.works(&["shard", "all", "a"]);
    stage.is_right("a");
    let a = stage.path("a");

    // A flipped bit in each kind of file, and the task that reads it.
    for (file, id, reader) in [
        ("evidence/0001.safetensors", "evidence/0001", "choose"),
        ("model.ply", "choose", "score/0000"),
        ("prune.json", "choose", "report"),
        ("score/0000.json", "score/0000", "report"),
    ] {
        let length = fs::metadata(a.join(file)).unwrap().len() as usize;
        flip(&a.join(file), length / 2);
        assert_eq!(stage.status("a", id), "damaged", "{file}");
        for output in ["model.ply", "score/0000.json", "metrics.json"].into_iter().filter(|o| *o != file) {
            if reader != "choose" && output == "model.ply" {
                continue;
            }
            let _ = fs::remove_file(a.join(output));
        }
        stage.refused(3, &[file], &["shard", "task", "a", reader]);
        stage.works(&["shard", "all", "a"]);
        stage.is_right("a");
    }

    let length = fs::metadata(a.join("metrics.json")).unwrap().len() as usize;
    flip(&a.join("metrics.json"), length / 2);
    assert_eq!(stage.status("a", "report"), "damaged");
    stage.works(&["shard", "all", "a"]);
    assert_eq!(stage.status("a", "report"), "done");

    // A part of another plan, of another task, and a model that changed.
    stage.works(&[
        "shard", "plan", "compress", "ball.ply", "-o", "b", "--views", "40", "--size", "72x56", "--keep", "0.3",
    ]);
    let job = ["shard", "plan", "compress", "ball.ply", "-o", "c d", "--selector", "css", "--detail", "0.9"];
    let said = stage.works(&[&job[..], &OPTIONS].concat()).said;
    assert!(said.contains("--detail 0.9 would reserve ") && said.contains(" are reserved, a fifth of the "), "{said}");
    assert!(said.contains("qirf-vk shard all 'c d', or snakemake -d 'c d' -s 'c d"), "{said}");
    fs::create_dir(stage.path("b/evidence")).unwrap();
    for n in ["0000", "0001", "0002"] {
        let part = format!("evidence/{n}.safetensors");
        fs::copy(a.join(&part), stage.path("b").join(&part)).unwrap();
    }
    stage.refused(3, &["another plan", "evidence"], &["shard", "task", "b", "choose"]);
    fs::copy(a.join("evidence/0000.safetensors"), a.join("evidence/0002.safetensors")).unwrap();
    fs::remove_file(a.join("model.ply")).unwrap();
    stage.refused(3, &["part of evidence/0000"], &["shard", "task", "a", "choose"]);
    stage.refused(2, &["is not empty"], &["shard", "plan", "compress", "ball.ply", "-o", "."]);
    stage.refused(2, &["holds another plan"], &["shard", "plan", "compress", "ball.ply", "-o", "a", "--keep", "0.4"]);
    stage.refused(2, &["no task"], &["shard", "task", "a", "evidence/0009"]);
    stage.refused(2, &["not a task"], &["shard", "task", "a", "dance"]);
    let mut foreign = stage.command(&["shard", "all", "a"]);
    end(foreign.env(FINGERPRINT.0, "4567")).with(4, &["4567", "0123"]);
    works(foreign.arg("--mixed"));
    stage.is_right("a");
    fs::remove_file(a.join("evidence/0000.safetensors")).unwrap();
    flip(&stage.path("ball.ply"), 5000);
    stage.refused(3, &["ball.ply", "has changed"], &["shard", "all", "a"]);
    fs::rename(stage.path("ball.ply"), stage.path("moved.ply")).unwrap();
    stage.refused(3, &["ball.ply: the plan names this input", "restore ", "plan again"], &["shard", "all", "a"]);
    stage.refused(3, &["b/evidence holds no plan: `qirf-vk shard plan`"], &["shard", "status", "b/evidence"]);
    let plan = fs::read_to_string(stage.path("b/plan.json")).unwrap();
    fs::write(stage.path("b/plan.json"), plan.replace("0.3", "0.4")).unwrap();
    stage.refused(3, &["plan.json", "one of them was changed"], &["shard", "status", "b"]);
    fs::write(stage.path("b/plan.json"), "{}").unwrap();
    stage.refused(3, &["plan.json", "not a plan"], &["shard", "status", "b"]);
}

/// Changes the content of a file of a task, and mends its seal.
fn reseal(path: &Path, change: impl FnOnce(&mut Value)) {
    let mut sealed: Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    change(&mut sealed["content"]);
    sealed.as_object_mut().unwrap().remove("crc32");
    sealed["crc32"] = crc(sealed.to_string().as_bytes()).into();
    fs::write(path, serde_json::to_vec_pretty(&sealed).unwrap()).unwrap();
}

fn crc(bytes: &[u8]) -> u32 {
    let mut crc = flate2::Crc::new();
    crc.update(bytes);
    crc.sum()
}

/// A wrong result that looks right: its seal is mended.
#[test]
fn work_is_verified_by_doing_it_again() {
    let stage = Stage::new();
    stage.plan("v");
    stage.refused(2, &["no task is done", "run `qirf-vk shard all v` first"], &["shard", "verify", "v"]);
    stage.refused(3, &["choose is not done; run `qirf-vk shard task v choose`"], &["shard", "task", "v", "report"]);
    stage.works(&["shard", "all", "v"]);
    let told = stage.works(&["shard", "verify", "v", "--share", "1"]).out;
    assert!(told.contains("5 of 5 tasks repeated: the bytes are the same (report is not repeated"), "{told}");

    let path = stage.path("v/score/0000.json");
    let whole = fs::read(&path).unwrap();
    flip(&path, whole.len() / 2);
    stage.refused(3, &["score/0000.json: ", "delete "], &["shard", "verify", "v", "--share", "0.1"]);
    fs::write(&path, whole).unwrap();
    #[cfg(target_os = "linux")]
    {
        // A folder that cannot be written, not even by root, in place of that of the locks.
        fs::rename(stage.path("v/locks"), stage.path("locks")).unwrap();
        std::os::unix::fs::symlink("/sys", stage.path("v/locks")).unwrap();
        stage.works(&["shard", "verify", "v", "--share", "0.1"]);
        fs::remove_file(stage.path("v/locks")).unwrap();
    }

    reseal(&path, |scores| scores[0]["scores"]["pruned"]["ssim"] = 0.123.into());
    assert_eq!(stage.status("v", "score/0000"), "done", "the seal holds");
    stage.refused(3, &["score/0000.json", "1 of 5 tasks gave other bytes"], &["shard", "verify", "v", "--share", "1"]);

    // Both files of a task differ.
    fs::remove_file(&path).unwrap();
    let model = stage.path("v/model.ply");
    flip(&model, fs::metadata(&model).unwrap().len() as usize / 2);
    let sum = crc(&fs::read(&model).unwrap());
    reseal(&stage.path("v/prune.json"), |notes| notes["model_crc32"] = sum.into());
    let says = ["1 of 4 tasks gave other bytes, choose first: ", "model.ply, ", "prune.json; delete these files"];
    stage.refused(3, &says, &["shard", "verify", "v", "--share", "1"]);
}

/// With photos as with own pictures; and a task decodes only the photos that it needs.
#[test]
fn tasks_decode_their_own_photos() {
    let mut stage = Stage::empty();
    stage.works(&["synth", "capture", "--views", "30", "--size", "64x48", "--points", "600"]);
    stage.works(&["run", "capture", "-o", "trained", "--iterations", "60", "--no-prune"]);
    let job = ["compress", "trained/model.ply", "--scene", "capture", "--selector", "css", "--exposure"];
    let whole = stage.works(&[&job[..], &["-o", "small.ply", "--json"]].concat()).json();
    stage.right = fs::read(stage.path("small.ply")).unwrap();
    let tasks = stage.planned("a", &job);
    assert_eq!(tasks.len(), 2 + 1 + 1 + 1, "26 photos to train on, 4 held out: {tasks:?}");
    stage.shuffled("a", tasks, 3, |command| command);
    stage.is_right("a");
    let read = |name: &str| serde_json::from_slice::<Value>(&fs::read(stage.path(name)).unwrap()).unwrap();
    same_figures(&read("a/metrics.json"), &whole);

    let plan = read("a/plan.json");
    let photos = &plan["job"]["compression"]["photos"];
    let last = photos[0].as_array().unwrap().last().unwrap().as_str().unwrap().to_owned();
    fs::write(stage.path("capture/images").join(&last), "no picture").unwrap();
    for written in ["a/evidence/0000.safetensors", "a/evidence/0001.safetensors", "a/score/0000.json"] {
        fs::remove_file(stage.path(written)).unwrap();
    }
    stage.works(&["shard", "task", "a", "evidence/0000"]);
    stage.works(&["shard", "task", "a", "score/0000"]);
    stage.refused(3, &[&last, "when the job was planned"], &["shard", "task", "a", "evidence/0001"]);
    let first = photos[0][0].as_str().unwrap();
    fs::copy(stage.path("capture/images").join(first), stage.path("capture/images").join(&last)).unwrap();
    stage.refused(3, &[&last, "has changed since the job was planned"], &["shard", "task", "a", "evidence/0001"]);
}
