//! Placement of meshes by nodes.

use glam::{DAffine3, DMat4, DQuat, DVec3};

use super::super::fault::{Fault, malformed};
use super::container::Store;
use super::document::{Copies, Document, Node};
use super::{AGAIN, MOST_PLACED};

/// A mesh, and the map from its node's axes to the scene's.
pub(super) struct Placed {
    pub mesh: usize,
    pub node: usize,
    pub map: DAffine3,
}

/// The visible meshes of the file's scene; all meshes of a file without nodes.
pub(super) fn meshes(document: &Document) -> Result<Vec<Placed>, Fault> {
    if document.nodes.is_empty() {
        let all = 0..document.meshes.len();
        return Ok(all.map(|mesh| Placed { mesh, node: 0, map: DAffine3::IDENTITY }).collect());
    }
    let fault = |node: usize, what: &str| malformed(format!("node {node}"), format!("{what}; {AGAIN}"));
    let mut children = vec![false; document.nodes.len()];
    for (i, node) in document.nodes.iter().enumerate() {
        for &child in &node.children {
            *children.get_mut(child).ok_or_else(|| fault(i, "has a child that does not exist"))? = true;
        }
    }
    let scene = document.scenes.get(document.scene.unwrap_or(0));
    if let (Some(number), None) = (document.scene, scene) {
        return Err(malformed("document", format!("its scene, number {number}, does not exist; {AGAIN}")));
    }
    let roots = scene.map_or_else(|| (0..children.len()).filter(|&i| !children[i]).collect(), |s| s.nodes.clone());
    let mut open: Vec<(usize, DAffine3)> = roots.into_iter().rev().map(|root| (root, DAffine3::IDENTITY)).collect();
    let mut seen = vec![false; document.nodes.len()];
    let mut placed = Vec::new();
    while let Some((i, above)) = open.pop() {
        let node = document.nodes.get(i).ok_or_else(|| fault(i, "does not exist"))?;
        if std::mem::replace(&mut seen[i], true) {
            return Err(fault(i, "has several parents"));
        }
        if node.is_hidden() {
            continue;
        }
        let map = above * local(node);
        if !map.is_finite() {
            return Err(fault(i, "its place is not finite"));
        }
        if let Some(mesh) = node.mesh {
            if mesh >= document.meshes.len() {
                return Err(fault(i, "its mesh does not exist"));
            }
            placed.push(Placed { mesh, node: i, map });
        }
        open.extend(node.children.iter().rev().map(|&child| (child, map)));
    }
    Ok(placed)
}

/// A node's own map.
fn local(node: &Node) -> DAffine3 {
    if let Some(columns) = &node.matrix {
        return DAffine3::from_mat4(DMat4::from_cols_array(columns));
    }
    let rotation = node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
    affine(node.scale.unwrap_or([1.0; 3]), rotation, node.translation.unwrap_or([0.0; 3]))
}

/// The map that scales, rotates by a quaternion (x, y, z, w), then translates.
fn affine(scale: [f64; 3], rotation: [f64; 4], translation: [f64; 3]) -> DAffine3 {
    let rotation = DQuat::from_array(rotation);
    // A zero quaternion becomes NaN, which is refused.
    let rotation = if rotation == DQuat::IDENTITY { rotation } else { rotation * rotation.length().recip() };
    DAffine3::from_scale_rotation_translation(DVec3::from(scale), rotation, DVec3::from(translation))
}

impl Placed {
    /// The maps of the mesh's copies to the scene's axes; that of the node without `EXT_mesh_gpu_instancing`.
    pub(super) fn copies(&self, store: &Store<'_>) -> Result<Vec<DAffine3>, Fault> {
        let instances = store.document.nodes.get(self.node).and_then(|node| node.extensions.instances.as_ref());
        let Copies { translation, rotation, scale } = instances.map(|i| i.attributes).unwrap_or_default();
        let Some(first) = translation.or(rotation).or(scale) else { return Ok(vec![self.map]) };
        let fault = |what: String| malformed(format!("node {}", self.node), format!("{what}; {AGAIN}"));
        let n = store.count(first)?;
        if n > MOST_PLACED {
            return Err(fault(format!("{n} copies of its mesh, at most {MOST_PLACED} are read")));
        }
        let numbers = |index: Option<usize>, usual: &[f32]| match index {
            Some(index) => store.floats(index, usual.len(), n),
            None => Ok(usual.repeat(n)),
        };
        let (translations, scales) = (numbers(translation, &[0.0; 3])?, numbers(scale, &[1.0; 3])?);
        let rotations = numbers(rotation, &[0.0, 0.0, 0.0, 1.0])?;
        let rows =
            scales.as_chunks::<3>().0.iter().zip(rotations.as_chunks::<4>().0).zip(translations.as_chunks::<3>().0);
        let maps: Vec<DAffine3> =
            rows.map(|((s, r), t)| self.map * affine(s.map(f64::from), r.map(f64::from), t.map(f64::from))).collect();
        if maps.iter().all(DAffine3::is_finite) { Ok(maps) } else { Err(fault("a copy's place is not finite".into())) }
    }
}
