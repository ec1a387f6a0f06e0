//! A bounding-volume hierarchy for a few hundred solids and tens of millions of rays.

use glam::{Vec3, Vec3A};

use super::geometry::{Ray, Solid};

const LEAF: usize = 2;
/// Maximum number of nodes on the stack: one per level, and trees of a few hundred solids have about 20 levels.
const STACK: usize = 64;

struct Node {
    /// Corners, as SIMD vectors.
    low: Vec3A,
    high: Vec3A,
    /// First solid of a leaf; index of the right child of an inner node (the left child comes next).
    first: u32,
    /// Solids in a leaf; 0 marks an inner node.
    count: u32,
}

/// The hierarchy; solids are identified by their index in the list that it was built from.
pub(super) struct Bvh {
    nodes: Vec<Node>,
    order: Vec<u32>,
}

impl Bvh {
    pub fn new(solids: &[Solid]) -> Self {
        let bounds: Vec<_> = solids.iter().map(Solid::bounds).collect();
        let mut bvh = Self { nodes: Vec::new(), order: (0..solids.len() as u32).collect() };
        if !solids.is_empty() {
            bvh.split(&bounds, 0, solids.len());
        }
        bvh
    }

    /// Splits where the surface area heuristic finds the fewest boxes and solids to test (Goldsmith, Salmon 1987).
    fn split(&mut self, bounds: &[(Vec3, Vec3)], begin: usize, end: usize) {
        let (low, high) = around(bounds, &self.order[begin..end]);
        let here = self.nodes.len();
        let mut node = Node { low: low.into(), high: high.into(), first: begin as u32, count: (end - begin) as u32 };
        if end - begin <= LEAF {
            self.nodes.push(node);
            return;
        }
        let mut best = (f32::INFINITY, Vec::new(), 1);
        for axis in 0..3 {
            let mut order = self.order[begin..end].to_vec();
            let middle = |i: &u32| bounds[*i as usize].0[axis] + bounds[*i as usize].1[axis];
            order.sort_unstable_by(|a, b| middle(a).total_cmp(&middle(b)).then(a.cmp(b)));
            // Quadratic in the number of solids, of which there are a few hundred.
            for left in 1..order.len() {
                let cost = |part: &[u32]| area(around(bounds, part)) * part.len() as f32;
                let cost = cost(&order[..left]) + cost(&order[left..]);
                if cost < best.0 {
                    best = (cost, order.clone(), left);
                }
            }
        }
        let (_, order, left) = best;
        // Without a finite box no cost is finite: such solids stay together in one leaf.
        if order.is_empty() {
            self.nodes.push(node);
            return;
        }
        self.order[begin..end].copy_from_slice(&order);
        node.count = 0;
        self.nodes.push(node);
        self.split(bounds, begin, begin + left);
        self.nodes[here].first = self.nodes.len() as u32;
        self.split(bounds, begin + left, end);
    }

    /// Distance to the first solid before `limit`, and its index.
    pub fn first(&self, solids: &[Solid], ray: &Ray, mut limit: f32) -> Option<(f32, u32)> {
        let mut found = None;
        self.walk(ray, limit, |i| {
            if let Some(t) = solids[i as usize].hit(ray)
                && t < limit
            {
                limit = t;
                found = Some((t, i));
            }
            Some(limit)
        });
        found
    }

    /// True if any solid lies before `limit`.
    pub fn any(&self, solids: &[Solid], ray: &Ray, limit: f32) -> bool {
        let mut met = false;
        self.walk(ray, limit, |i| {
            met = solids[i as usize].hit(ray).is_some_and(|t| t < limit);
            (!met).then_some(limit)
        });
        met
    }

    /// Calls `visit` for the solids whose boxes the ray hits before the limit; `visit` returns the new limit, or `None`
    /// to stop.
    fn walk(&self, ray: &Ray, mut limit: f32, mut visit: impl FnMut(u32) -> Option<f32>) {
        if self.nodes.is_empty() {
            return;
        }
        let (origin, inverse) = (Vec3A::from(ray.origin), Vec3A::from(ray.direction.recip()));
        let enter = |n: u32, limit: f32| {
            let node = &self.nodes[n as usize];
            let (a, b) = ((node.low - origin) * inverse, (node.high - origin) * inverse);
            let (near, far) = (a.min(b).max_element().max(0.0), a.max(b).min_element());
            (near <= far && near < limit).then_some(near)
        };
        let mut stack = [(0u32, 0f32); STACK];
        let Some(near) = enter(0, limit) else { return };
        stack[0] = (0, near);
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let (n, near) = stack[top];
            if near >= limit {
                continue;
            }
            let node = &self.nodes[n as usize];
            if node.count > 0 {
                for &i in &self.order[node.first as usize..(node.first + node.count) as usize] {
                    match visit(i) {
                        Some(new) => limit = new,
                        None => return,
                    }
                }
                continue;
            }
            let mut children = [(n + 1, enter(n + 1, limit)), (node.first, enter(node.first, limit))];
            // The nearer child is taken from the stack first.
            if children[0].1 < children[1].1 {
                children.swap(0, 1);
            }
            for (child, near) in children {
                if let Some(near) = near {
                    stack[top] = (child, near);
                    top += 1;
                }
            }
        }
    }
}

/// The bounding box of some solids' boxes.
fn around(bounds: &[(Vec3, Vec3)], solids: &[u32]) -> (Vec3, Vec3) {
    let boxes = solids.iter().map(|&i| bounds[i as usize]);
    boxes.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// Half the surface area of a box.
fn area((low, high): (Vec3, Vec3)) -> f32 {
    let d = high - low;
    d.x * d.y + d.y * d.z + d.z * d.x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hierarchy_finds_what_a_plain_search_finds() {
        let solids: Vec<_> = (0..150)
            .map(|i| {
                let a = i as f32;
                let centre = Vec3::new((a * 1.7).sin() * 2.0, (a * 2.3).cos() * 2.0, (a * 0.9).sin() + 1.0);
                Solid::Sphere { centre, radius: 0.05 + 0.01 * (i % 9) as f32 }
            })
            .collect();
        let bvh = Bvh::new(&solids);
        let mut met = 0;
        for i in 0..3000 {
            let a = i as f32 * 0.13;
            let origin = Vec3::new(7.0 * a.cos(), 7.0 * a.sin(), (i % 10) as f32 * 0.4);
            let target = Vec3::new((a * 3.1).sin() * 2.0, (a * 1.9).cos() * 2.0, 1.0 + (a * 0.7).sin());
            let ray = Ray { origin, direction: (target - origin).normalize() };
            let plain = (0..solids.len())
                .filter_map(|s| solids[s].hit(&ray).map(|t| (t, s as u32)))
                .min_by(|x, y| x.0.total_cmp(&y.0));
            assert_eq!(bvh.first(&solids, &ray, f32::INFINITY), plain);
            assert_eq!(bvh.any(&solids, &ray, f32::INFINITY), plain.is_some());
            met += usize::from(plain.is_some());
        }
        assert!(met > 500, "only {met} rays met anything");
        assert!(Bvh::new(&[]).first(&[], &Ray { origin: Vec3::ZERO, direction: Vec3::X }, 1.0).is_none());
    }
}
