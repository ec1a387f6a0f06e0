//! Groups of photos of a capture that see the same points.

use super::Scene;

impl Scene {
    /// The groups of photos that points connect: the photos' names in ascending order, the largest group first. None where
    /// points have no tracks.
    pub fn overlap(&self) -> Option<Vec<Vec<String>>> {
        if self.points.iter().all(|point| point.track.is_empty()) {
            return None;
        }
        // The views of a photo that was cut are one from the start.
        let mut parent: Vec<usize> = (0..self.views.len()).collect();
        let mut first = std::collections::HashMap::new();
        for (v, view) in self.views.iter().enumerate() {
            parent[v] = *first.entry(view.photo_name()).or_insert(v);
        }
        for pair in self.points.iter().flat_map(|point| point.track.windows(2)) {
            let [a, b] = [pair[0], pair[1]].map(|v| root(&mut parent, v as usize));
            parent[a.max(b)] = a.min(b);
        }
        let mut groups: Vec<Vec<String>> = vec![Vec::new(); self.views.len()];
        for v in 0..self.views.len() {
            let (group, name) = (root(&mut parent, v), self.views[v].photo_name());
            if first.get(name) == Some(&v) {
                groups[group].push(name.to_owned());
            }
        }
        groups.retain(|group| !group.is_empty());
        groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
        Some(groups)
    }
}

fn root(parent: &mut [usize], mut n: usize) -> usize {
    while parent[n] != n {
        parent[n] = parent[parent[n]];
        n = parent[n];
    }
    n
}
