//! Ctrl-C, SIGTERM and the closing of the terminal, on Windows also Ctrl-Break: the first one asks the work to end at the next step,
//! the second one ends the program. Commands without steps are ended by the first one.

#[cfg(not(windows))]
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
#[cfg(not(windows))]
use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

/// Notes whether Ctrl-C was pressed since the process's first watch started. Commands without steps keep no watch.
pub(super) struct Watch(Arc<AtomicBool>);

/// The flag of all watches of the process. A part of a job that begins a watch of its own still learns of an earlier Ctrl-C.
static ASKED: OnceLock<Arc<AtomicBool>> = OnceLock::new();

impl Watch {
    /// Starts to watch.
    pub fn begin() -> Self {
        Self(Arc::clone(ASKED.get_or_init(watched)))
    }

    /// Returns true if Ctrl-C was pressed.
    pub fn pressed(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// True until a watch begins.
#[cfg(not(windows))]
static UNWATCHED: LazyLock<Arc<AtomicBool>> = LazyLock::new(|| Arc::new(AtomicBool::new(true)));

/// Until a watch begins, Ctrl-C, SIGTERM and the closing of the terminal end the program with the exit code of an interruption, unless
/// they were ignored at its start. Where the system does not tell that, SIGHUP is left alone: under nohup it is ignored.
pub(super) fn end_at_once() {
    #[cfg(not(windows))]
    for (signal, where_unknown) in [(SIGINT, true), (SIGTERM, true), (SIGHUP, false)] {
        if is_ignored(signal).map_or(where_unknown, |ignored| !ignored) {
            let _ = signal_hook::flag::register_conditional_shutdown(signal, 130, Arc::clone(&UNWATCHED));
        }
    }
}

#[cfg(not(windows))]
fn watched() -> Arc<AtomicBool> {
    use signal_hook::flag;
    let asked = Arc::new(AtomicBool::new(false));
    // In this order, the first Ctrl-C finds the flag unset and sets it, the second finds it set.
    for signal in [SIGINT, SIGTERM] {
        let watching = flag::register_conditional_shutdown(signal, 130, Arc::clone(&asked))
            .and_then(|_| flag::register(signal, Arc::clone(&asked)));
        if let Err(e) = watching {
            tracing::debug!("signal {signal} will end the program at once: {e}");
        }
    }
    // Shell and system may both tell that the terminal is closed: a second time ends nothing.
    if is_ignored(SIGHUP) == Some(false) {
        let _ = flag::register(SIGHUP, Arc::clone(&asked));
    }
    // Only now: no signal is lost on the way.
    UNWATCHED.store(false, Ordering::SeqCst);
    asked
}

/// True for a signal that is ignored, as SIGHUP under nohup, where the system tells.
#[cfg(not(windows))]
fn is_ignored(signal: i32) -> Option<bool> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let ignored = status.lines().find_map(|line| u64::from_str_radix(line.strip_prefix("SigIgn:")?.trim(), 16).ok())?;
    Some(ignored & 1 << (signal - 1) != 0)
}

/// One thread for the whole process waits for the console's events. Closing its window is one: Windows leaves the program five
/// seconds then, and ends it at once if its handler returns, which tokio's does not.
#[cfg(windows)]
fn watched() -> Arc<AtomicBool> {
    let asked = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&asked);
    let (ready, wait) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let ended = listen(&ready, || {
            if flag.swap(true, Ordering::SeqCst) {
                std::process::exit(130);
            }
        });
        if let Err(e) = ended {
            tracing::debug!("Ctrl-C will end the program at once: {e}");
        }
    });
    // It listens now, or has ended.
    let _ = wait.recv();
    asked
}

/// Calls `asked` at each event of the console that should end the program; never returns but with an error.
#[cfg(windows)]
fn listen(ready: &std::sync::mpsc::Sender<()>, asked: impl Fn()) -> std::io::Result<()> {
    use tokio::signal::windows;
    tokio::runtime::Builder::new_current_thread().build()?.block_on(async {
        let (mut c, mut pause) = (windows::ctrl_c()?, windows::ctrl_break()?);
        let (mut close, mut shutdown) = (windows::ctrl_close()?, windows::ctrl_shutdown()?);
        let _ = ready.send(());
        loop {
            std::future::poll_fn(|context| {
                let polls = [
                    c.poll_recv(context),
                    pause.poll_recv(context),
                    close.poll_recv(context),
                    shutdown.poll_recv(context),
                ];
                if polls.iter().any(std::task::Poll::is_ready) {
                    std::task::Poll::Ready(())
                } else {
                    std::task::Poll::Pending
                }
            })
            .await;
            asked();
        }
    })
}

/// Turns a write beyond the process's file-size limit into an error that names file and cause; otherwise the system
/// would end the program.
pub(super) fn outlive_the_file_size_limit() {
    #[cfg(unix)]
    if let Err(e) = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default()) {
        tracing::debug!("a write beyond the file-size limit will end the program at once: {e}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_later_watch_knows_of_an_earlier_interruption() {
        let [first, second] = [(); 2].map(|()| Watch::begin());
        assert!(Arc::ptr_eq(&first.0, &second.0) && !second.pressed());
    }
}
