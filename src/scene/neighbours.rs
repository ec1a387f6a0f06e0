//! Neighbours of points, and copies of points among them: clouds that were joined hold surfaces several times, each a little aside.

use glam::DVec3;
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;

use crate::sample::evenly;

/// Neighbours among which copies of a point are told from others.
const NEIGHBOURS: usize = 24;
/// Copies of a point lie within this share of the distance to the last of these neighbours.
const COPY: f64 = 0.05;
/// Points looked at for copies.
const LOOKED: usize = 1000;

/// Finite points, to find neighbours of.
pub(crate) struct Neighbours {
    /// World coordinates.
    places: Vec<DVec3>,
    tree: RTree<GeomWithData<[f64; 3], usize>>,
    /// Share of the points that have a copy, of those looked at: 6 % in clean clouds, and 69 % on clean lines.
    pub copied: f64,
}

impl Neighbours {
    /// The neighbours of points at these world coordinates; points that are not finite are no neighbours.
    pub fn of(places: Vec<DVec3>) -> Self {
        // The tree cannot order NaN.
        let finite: Vec<usize> = (0..places.len()).filter(|i| places[*i].is_finite()).collect();
        let tree = RTree::bulk_load(finite.iter().map(|i| GeomWithData::new(places[*i].to_array(), *i)).collect());
        let mut neighbours = Self { places, tree, copied: 0.0 };
        let looked: Vec<&usize> = evenly(&finite, LOOKED).collect();
        let copied = looked.par_iter().filter(|i| neighbours.has_copy(***i)).count();
        neighbours.copied = copied as f64 / looked.len().max(1) as f64;
        neighbours
    }

    /// The other points by their distance from a finite one, which is squared.
    pub fn nearest(&self, i: usize) -> impl Iterator<Item = (usize, f64)> {
        let near = self.tree.nearest_neighbor_iter_with_distance_2(self.places[i].to_array());
        near.map(|(entry, d)| (entry.data, d)).filter(move |(other, _)| *other != i)
    }

    /// The first of [`Self::nearest`], and the squared distance within which points are copies.
    pub fn around(&self, i: usize) -> (Vec<(usize, f64)>, f64) {
        let near: Vec<(usize, f64)> = self.nearest(i).take(NEIGHBOURS).collect();
        let apart = COPY * COPY * near.last().map_or(0.0, |(_, d)| *d);
        (near, apart)
    }

    fn has_copy(&self, i: usize) -> bool {
        let (near, apart) = self.around(i);
        near.len() == NEIGHBOURS && near[0].1 < apart
    }

    /// For each point, the first one that it is a copy of, or itself if there is none. First ones are no copies.
    pub fn firsts(&self) -> Vec<usize> {
        let earlier = |i: usize| -> Vec<usize> {
            if !self.places[i].is_finite() {
                return Vec::new();
            }
            let (near, apart) = self.around(i);
            near.iter().filter(|(other, d)| *other < i && *d < apart).map(|(other, _)| *other).collect()
        };
        let earlier: Vec<Vec<usize>> = (0..self.places.len()).into_par_iter().map(earlier).collect();
        let mut firsts: Vec<usize> = Vec::with_capacity(earlier.len());
        for (i, earlier) in earlier.iter().enumerate() {
            // An earlier point may be a copy itself.
            let first = earlier.iter().copied().filter(|other| firsts[*other] == *other).min();
            firsts.push(first.unwrap_or(i));
        }
        firsts
    }
}
