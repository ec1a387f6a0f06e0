//! Greedy merging: repeatedly the pair of neighbours that costs least.

use super::footprint::Footprint;
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Number of nearest Gaussians that each may merge with; merged Gaussians inherit the neighbours of both.
const NEIGHBOURS: usize = 10;

/// Gaussians that become one.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Cluster {
    /// Their indices, rising.
    pub members: Vec<usize>,
    /// Opacity of the merged one.
    pub opacity: f64,
}

/// A merge: the position that remains, the position merged into it, and the result.
struct Merge {
    stays: u32,
    goes: u32,
    opacity: f64,
    contribution: f64,
}

/// Merges of pairs, cheapest first, which can be replayed down to any number: a smaller model's merges begin with a
/// larger one's.
pub(super) struct Sequence {
    /// Opacity and contribution of each footprint before the first merge.
    begun: Vec<(f64, f64)>,
    merges: Vec<Merge>,
}

impl Sequence {
    /// Merges pairs of `footprints` until at most `least` are left, or no neighbours.
    pub fn new(footprints: Vec<Footprint>, least: usize) -> Self {
        let begun = footprints.iter().map(|f| (f.opacity, f.contribution)).collect();
        let mut merging = Merging::new(footprints);
        while merging.left > least && merging.step() {}
        Self { begun, merges: merging.merges }
    }

    /// The clusters once at most `target` are left, which must not be below the `least` of the sequence; if neighbours
    /// run out before, those that contribute least are dropped. Ordered by the clusters' first members.
    pub fn clusters(&self, target: usize) -> Vec<Cluster> {
        let n = self.begun.len();
        let mut into: Vec<u32> = (0..n as u32).collect();
        let mut shown = self.begun.clone();
        for merge in self.merges.iter().take(n.saturating_sub(target)) {
            into[merge.goes as usize] = merge.stays;
            shown[merge.stays as usize] = (merge.opacity, merge.contribution);
        }
        let mut members: Vec<Vec<usize>> = vec![Vec::new(); n];
        for i in 0..n {
            let mut root = i;
            while into[root] as usize != root {
                root = into[root] as usize;
            }
            members[root].push(i);
        }
        let of = |(members, (opacity, contribution)): (Vec<usize>, &(f64, f64))| {
            (Cluster { members, opacity: *opacity }, *contribution)
        };
        let mut clusters: Vec<_> =
            members.into_iter().zip(&shown).filter(|(members, _)| !members.is_empty()).map(of).collect();
        if clusters.len() > target {
            clusters.sort_by(|(a, x), (b, y)| y.total_cmp(x).then(a.members.cmp(&b.members)));
            clusters.truncate(target);
        }
        clusters.sort_by(|(a, _), (b, _)| a.members.cmp(&b.members));
        clusters.into_iter().map(|(cluster, _)| cluster).collect()
    }
}

/// A pair in the queue: its cost as bits, which order like the cost, and its two numbers.
type Entry = Reverse<(u32, u32, u32)>;

/// The state of merging. Merged Gaussians get new numbers, so that a pair in the queue is valid as long as both of its
/// numbers exist.
struct Merging {
    /// By position; the footprint of a merged Gaussian takes the position of its first part.
    footprints: Vec<Footprint>,
    /// By number: its position, or GONE.
    place: Vec<u32>,
    /// By position: numbers of the neighbours, some of them gone.
    links: Vec<Vec<u32>>,
    /// The merges so far.
    merges: Vec<Merge>,
    queue: BinaryHeap<Entry>,
    left: usize,
}

const GONE: u32 = u32::MAX;

impl Merging {
    fn new(footprints: Vec<Footprint>) -> Self {
        let n = footprints.len();
        let links = neighbours(&footprints);
        let pairs = |(i, links): (usize, &Vec<u32>)| {
            let later = links.iter().filter(|j| **j as usize > i);
            later.map(|&j| Reverse((footprints[i].cost(&footprints[j as usize]).to_bits(), i as u32, j))).collect()
        };
        let pairs: Vec<Vec<Entry>> = links.par_iter().enumerate().map(|(i, links)| pairs((i, links))).collect();
        let queue = pairs.into_iter().flatten().collect::<Vec<_>>().into();

        Self { footprints, place: (0..n as u32).collect(), links, merges: Vec::new(), queue, left: n }
    }

    /// Merges the pair that costs least; returns false if there is none.
    fn step(&mut self) -> bool {
        while let Some(Reverse((_, i, j))) = self.queue.pop() {
            let (a, b) = (self.place[i as usize], self.place[j as usize]);
            if a != GONE && b != GONE {
                self.merge([i, j], [a as usize, b as usize]);
                return true;
            }
        }
        false
    }

    fn merge(&mut self, [i, j]: [u32; 2], [a, b]: [usize; 2]) {
        let merged = self.footprints[a].merged(&self.footprints[b]);
        let Footprint { opacity, contribution, .. } = merged;
        self.merges.push(Merge { stays: a as u32, goes: b as u32, opacity, contribution });
        self.footprints[a] = merged;
        let number = self.place.len() as u32;
        self.place.push(a as u32);
        (self.place[i as usize], self.place[j as usize]) = (GONE, GONE);
        self.left -= 1;
        let mut links = std::mem::take(&mut self.links[a]);
        links.append(&mut self.links[b]);
        links.retain(|k| self.place[*k as usize] != GONE);
        links.sort_unstable();
        links.dedup();
        for &k in &links {
            let at = self.place[k as usize] as usize;
            let cost = self.footprints[at].cost(&self.footprints[a]);
            self.queue.push(Reverse((cost.to_bits(), k, number)));
            let theirs = &mut self.links[at];
            theirs.retain(|k| self.place[*k as usize] != GONE);
            theirs.push(number);
        }
        self.links[a] = links;
    }
}

/// The nearest Gaussians of each, by distance and number; being neighbours is mutual.
fn neighbours(footprints: &[Footprint]) -> Vec<Vec<u32>> {
    let point = |(i, f): (usize, &Footprint)| GeomWithData::new(f.mean.to_array(), i as u32);
    let tree = RTree::bulk_load(footprints.iter().enumerate().map(point).collect());
    let near = |(i, f): (usize, &Footprint)| {
        let others = tree.nearest_neighbor_iter(f.mean.to_array()).map(|p| p.data).filter(|j| *j as usize != i);
        others.take(NEIGHBOURS).collect()
    };
    let near: Vec<Vec<u32>> = footprints.par_iter().enumerate().map(near).collect();
    let mut links = near.clone();
    for (i, list) in near.iter().enumerate() {
        for &j in list {
            if !near[j as usize].contains(&(i as u32)) {
                links[j as usize].push(i as u32);
            }
        }
    }
    links
}
