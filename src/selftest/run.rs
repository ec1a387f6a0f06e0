//! Running the cases, one after the other or several in parallel.

use super::{Case, Check, cases};
use crate::gpu::{self, Device};
use crate::lock::lock;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Mutex;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;

/// Progress of a run of the cases.
pub enum News<'a> {
    /// The cases being run now.
    UnderWay(&'a [&'static Case]),
    /// A case has finished; cases are reported in their order, whichever ended first.
    Done(&'a [Check]),
}

/// A worker's message.
enum Step {
    Begun(usize, &'static Case),
    Done(usize, gpu::Result<Vec<Check>>),
}

/// Cases that no worker has taken yet, by position.
type Waiting = Mutex<VecDeque<(usize, &'static Case)>>;

/// Runs the cases, all or only the quick ones, on handles of one device, each on its own thread. Drivers of CPU devices
/// compile a kernel at its first dispatch, on the thread of the queue, so that two handles keep two cores busy.
///
/// # Errors
/// A lost device or a lack of memory; the first error of `watch`, which is called on the caller's thread.
pub fn run<E: From<gpu::Error>>(
    handles: &[Device],
    only_quick: bool,
    mut watch: impl FnMut(News<'_>) -> Result<(), E>,
) -> Result<Vec<Check>, E> {
    let waiting: Waiting = Mutex::new(cases(only_quick).enumerate().collect());
    let (tell, hear) = mpsc::channel();
    thread::scope(|scope| {
        for (n, device) in handles.iter().enumerate() {
            let (waiting, tell) = (&waiting, tell.clone());
            scope.spawn(move || work(device, waiting, n % 2 == 1, &tell));
        }
        drop(tell);
        let heard = gather(&hear, &mut watch);
        if heard.is_err() {
            lock(&waiting).clear();
        }
        heard
    })
}

/// Takes cases from one end until none is left, or one fails for lack of a device. Two workers from both ends meet
/// late, and therefore seldom compile the same kernel at the same time.
fn work(device: &Device, waiting: &Waiting, from_the_end: bool, tell: &Sender<Step>) {
    loop {
        let mut cases = lock(waiting);
        let next = if from_the_end { cases.pop_back() } else { cases.pop_front() };
        drop(cases);
        let Some((index, case)) = next else { return };
        // If nobody receives any more, the caller has ended with an error.
        let _ = tell.send(Step::Begun(index, case));
        let done = case.run(device);
        let over = done.is_err();
        if tell.send(Step::Done(index, done)).is_err() || over {
            return;
        }
    }
}

/// Puts the workers' messages into order.
fn gather<E: From<gpu::Error>>(
    hear: &Receiver<Step>,
    watch: &mut impl FnMut(News<'_>) -> Result<(), E>,
) -> Result<Vec<Check>, E> {
    let mut under_way: Vec<(usize, &'static Case)> = Vec::new();
    let mut ended: BTreeMap<usize, Vec<Check>> = BTreeMap::new();
    let (mut all, mut next) = (Vec::new(), 0);
    for step in hear {
        match step {
            Step::Begun(index, case) => under_way.push((index, case)),
            Step::Done(index, checks) => {
                under_way.retain(|(i, _)| *i != index);
                ended.insert(index, checks?);
                while let Some(checks) = ended.remove(&next) {
                    watch(News::Done(&checks))?;
                    all.extend(checks);
                    next += 1;
                }
            }
        }
        let cases: Vec<_> = under_way.iter().map(|(_, case)| *case).collect();
        watch(News::UnderWay(&cases))?;
    }
    Ok(all)
}
