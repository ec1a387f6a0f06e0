//! The host's memory: the machine's, or less where the program is in a group of processes with a limit, such as a container or
//! a job of a cluster.

use std::fs;
use std::path::{Path, PathBuf};

/// Bytes of memory that this program may use at most; none if the system does not report it.
pub fn physical() -> Option<u64> {
    of(Path::new("/")).or_else(without_proc)
}

/// The machine's memory on systems that have no `/proc`.
#[cfg(not(target_os = "linux"))]
fn without_proc() -> Option<u64> {
    let mut system = sysinfo::System::new();
    system.refresh_memory();
    Some(system.total_memory()).filter(|bytes| *bytes > 0)
}

#[cfg(target_os = "linux")]
fn without_proc() -> Option<u64> {
    None
}

/// The memory that [`physical`] returns, on a system whose files are below `root`.
fn of(root: &Path) -> Option<u64> {
    let read = |path: &str| fs::read_to_string(root.join(path)).ok();
    let info = read("proc/meminfo")?;
    let line = info.lines().find_map(|l| l.strip_prefix("MemTotal:"))?;
    let machine = line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? << 10;
    let [groups, mounts] = ["proc/self/cgroup", "proc/self/mountinfo"].map(|path| read(path).unwrap_or_default());
    let limit = |file: PathBuf| read(file.strip_prefix("/").ok()?.to_str()?)?.trim().parse::<u64>().ok();
    Some(limit_files(&groups, &mounts).into_iter().filter_map(limit).fold(machine, u64::min))
}

/// The files that may hold a limit: of each of the process's groups that control memory, and of every group above it. They may be
/// absent, and say `max` where there is no limit.
///
/// `groups` is `/proc/self/cgroup`, and `mounts` is `/proc/self/mountinfo`.
fn limit_files(groups: &str, mounts: &str) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for line in groups.lines() {
        let mut fields = line.splitn(3, ':');
        let (Some(_), Some(controllers), Some(group)) = (fields.next(), fields.next(), fields.next()) else { continue };
        let unified = controllers.is_empty();
        if !unified && !controllers.split(',').any(|c| c == "memory") {
            continue;
        }
        let name = if unified { "memory.max" } else { "memory.limit_in_bytes" };
        for Mount { root, point } in mounts.lines().filter_map(|line| Mount::of(line, unified)) {
            // A group outside of what is mounted is seen through its mount's own root.
            let below = Path::new(group).strip_prefix(root).ok().filter(|p| !p.starts_with(".."));
            let path = below.map_or_else(|| PathBuf::from(point), |below| Path::new(point).join(below));
            let above = path.ancestors().take_while(|p| p.starts_with(point));
            files.extend(above.map(|folder| folder.join(name)));
        }
    }
    files
}

/// A mounted tree of groups.
struct Mount<'a> {
    /// The group that is mounted.
    root: &'a str,
    point: &'a str,
}

impl<'a> Mount<'a> {
    /// A line of `mountinfo`, if it mounts the unified tree of groups, or else the older one that limits memory.
    fn of(line: &'a str, unified: bool) -> Option<Self> {
        let (front, back) = line.split_once(" - ")?;
        let mut back = back.split(' ');
        let (kind, _, options) = (back.next()?, back.next()?, back.next()?);
        let right =
            if unified { kind == "cgroup2" } else { kind == "cgroup" && options.split(',').any(|o| o == "memory") };
        let mut front = front.split(' ').skip(3);
        let mount = Self { root: front.next()?, point: front.next()? };
        right.then_some(mount)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const V2: &str = "30 24 0:26 / /sys/fs/cgroup rw,nosuid shared:4 - cgroup2 cgroup2 rw,nsdelegate\n";
    const V1: &str = "24 1 8:1 / / rw - ext4 /dev/sda rw\n\
        35 30 0:30 / /sys/fs/cgroup/cpu,cpuacct rw shared:8 - cgroup cgroup rw,cpu,cpuacct\n\
        36 30 0:31 / /sys/fs/cgroup/memory rw shared:9 - cgroup cgroup rw,memory\n";

    /// A system of 64 GiB with these files.
    fn system(groups: &str, mounts: &str, limits: &[(&str, &str)]) -> Option<u64> {
        let root = tempfile::tempdir().unwrap();
        let own = [
            ("proc/meminfo", "Buffers: 1 kB\nMemTotal:       67108864 kB\n"),
            ("proc/self/cgroup", groups),
            ("proc/self/mountinfo", mounts),
        ];
        for (path, text) in own.iter().chain(limits) {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        of(root.path())
    }

    #[test]
    fn a_job_has_the_least_limit_of_the_groups_above_it() {
        let group = "0::/system.slice/slurmstepd.scope/job_7/step_0/user\n";
        let job = "sys/fs/cgroup/system.slice/slurmstepd.scope/job_7";
        let [of_job, of_step] = [format!("{job}/memory.max"), format!("{job}/step_0/memory.max")];
        let with = |limits: &[(&str, &str)]| system(group, V2, limits);
        assert_eq!(with(&[]), Some(64 << 30));
        assert_eq!(with(&[(&of_job, "8589934592\n"), (&of_step, "max\n")]), Some(8 << 30));
        assert_eq!(with(&[(&of_job, "8589934592\n"), (&of_step, "4294967296\n")]), Some(4 << 30));
        assert_eq!(with(&[("sys/fs/cgroup/memory.max", "1073741824\n"), (&of_job, "8589934592\n")]), Some(1 << 30));
        assert_eq!(with(&[("sys/fs/cgroup/system.slice/other/memory.max", "1\n")]), Some(64 << 30), "another's");
    }

    #[test]
    fn older_groups_count_by_their_controller() {
        let groups = "12:cpu,cpuacct:/slurm/uid_1/job_7\n4:memory:/slurm/uid_1/job_7\n0::/\n";
        let limits = [
            ("sys/fs/cgroup/memory/slurm/memory.limit_in_bytes", "9223372036854771712\n"),
            ("sys/fs/cgroup/memory/slurm/uid_1/job_7/memory.limit_in_bytes", "2147483648\n"),
            ("sys/fs/cgroup/cpu,cpuacct/slurm/memory.limit_in_bytes", "1\n"),
        ];
        assert_eq!(system(groups, V1, &limits), Some(2 << 30));
    }

    #[test]
    fn containers_see_their_group_at_the_root() {
        let bound = V2.replace(" / ", " /docker/abc ");
        for (group, mounts) in [("0::/\n", V2), ("0::/docker/abc\n", bound.as_str()), ("0::/../other\n", V2)] {
            assert_eq!(system(group, mounts, &[("sys/fs/cgroup/memory.max", "3221225472")]), Some(3 << 30), "{group}");
        }
    }

    #[test]
    fn without_the_files_the_machine_counts() {
        assert_eq!(system("", "", &[]), Some(64 << 30));
        assert_eq!(system("nonsense\n0::", "a b - c", &[]), Some(64 << 30));
        assert_eq!(of(Path::new("/proc/nowhere")), None);
        assert!(physical().is_some_and(|bytes| bytes > 64 << 20));
    }
}
