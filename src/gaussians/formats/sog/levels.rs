//! Streamed SOG: levels of detail in a tree of boxes. `lod-meta.json` names SOG folders and says of each leaf where its Gaussians of
//! each level are; a viewer loads the level that a leaf needs at its distance.

use super::super::fault::{Fault, malformed};
use super::super::{Gaussians, Parsed, RenderMode, SogPrecision, Tag, stays_within};
use super::means::Means;
use super::pack::files as pack_files;
use super::unpack;
use crate::scene::text_of;
use glam::{Mat3, Quat, Vec3};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Name of the file that describes all others.
pub(in super::super) const LEVELS: &str = "lod-meta.json";
/// A leaf has at most so many Gaussians of the finest level, and a folder about as many.
const LEAF: usize = 1 << 17;
/// Leaves that are longer than this, in world units, are halved too, down to `SMALL` Gaussians.
const LONGEST: f32 = 16.0;
const SMALL: usize = 1 << 13;
/// Standard deviations within a box.
const REACH: f32 = 3.0;
const AGAIN: &str = "export the model again";

/// A Gaussian: its level and its number there.
type Member = (usize, u32);

/// The levels of a model as files, by path within a folder, each of its own precision; the finest level comes first.
pub(in super::super) fn pack(
    levels: &[Gaussians],
    mode: RenderMode,
    precisions: &[SogPrecision],
) -> Result<Vec<(String, Vec<u8>)>, Fault> {
    let mut members = Vec::new();
    for (level, model) in levels.iter().enumerate() {
        let order = Means::new(model, precisions[level].mean)?.order(model);
        members.extend(order.into_iter().map(|i| (level, i)));
    }
    let mut writer = Writer { levels, leaves: Vec::new() };
    let tree = writer.node(members);
    let mut files = Vec::new();
    let mut names: Vec<String> = Vec::new();
    let mut places = vec![Map::new(); writer.leaves.len()];
    for (level, model) in levels.iter().enumerate() {
        let mut folder: Vec<u32> = Vec::new();
        let mut in_level = 0;
        for (k, leaf) in writer.leaves.iter().enumerate() {
            let own: Vec<u32> = leaf.iter().filter(|(l, _)| *l == level).map(|(_, i)| *i).collect();
            if !own.is_empty() {
                let place = json!({ "file": names.len(), "offset": folder.len(), "count": own.len() });
                places[k].insert(level.to_string(), place);
                folder.extend(own);
            }
            if !folder.is_empty() && (folder.len() >= LEAF || k + 1 == writer.leaves.len()) {
                let part = model.select(&folder.iter().map(|i| *i as usize).collect::<Vec<_>>());
                let order: Vec<u32> = (0..part.len() as u32).collect();
                let precision = &precisions[level];
                let means = Means::new(&part, precision.mean)?;
                let name = format!("{level}_{in_level}");
                let packed = pack_files(&part, mode, (precision, &means, &order))?;
                files.extend(packed.into_iter().map(|(file, content)| (format!("{name}/{file}"), content)));
                names.push(format!("{name}/meta.json"));
                in_level += 1;
                folder.clear();
            }
        }
    }
    let counts: Vec<usize> = levels.iter().map(Gaussians::len).collect();
    let meta = json!({
        "version": 1,
        "asset": { "generator": concat!("qirf-vk ", env!("CARGO_PKG_VERSION")) },
        "count": counts.iter().sum::<usize>(),
        "counts": counts,
        "lodLevels": levels.len(),
        "lodErrors": false,
        "filenames": names,
        "tree": filled(tree, &places),
    });
    files.push((LEVELS.to_owned(), meta.to_string().into_bytes()));
    Ok(files)
}

/// The tree with the places of its leaves, which it names by number.
fn filled(mut node: Value, places: &[Map<String, Value>]) -> Value {
    if let Some(children) = node.get_mut("children").and_then(Value::as_array_mut) {
        for child in children {
            *child = filled(child.take(), places);
        }
    } else if let Some(leaf) = node["lods"].as_u64() {
        node["lods"] = Value::Object(places[leaf as usize].clone());
    }
    node
}

/// Halves boxes until they are leaves.
struct Writer<'a> {
    levels: &'a [Gaussians],
    leaves: Vec<Vec<Member>>,
}

impl Writer<'_> {
    fn node(&mut self, members: Vec<Member>) -> Value {
        let mean = |(level, i): &Member| Vec3::from(self.levels[*level].means[*i as usize]);
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let (mut from, mut to) = (low, high);
        for member in &members {
            let (centre, reach) = (mean(member), self.reach(*member));
            (low, high) = (low.min(centre - reach), high.max(centre + reach));
            (from, to) = (from.min(centre), to.max(centre));
        }
        let bound = json!({ "min": low.to_array(), "max": high.to_array() });
        let finest = members.iter().filter(|(level, _)| *level == 0).count();
        let extent = to - from;
        if finest <= LEAF && (extent.max_element() <= LONGEST || finest <= SMALL) || members.len() < 2 {
            self.leaves.push(members);
            return json!({ "bound": bound, "lods": self.leaves.len() - 1 });
        }
        let axis = (0..3).max_by(|a, b| extent[*a].total_cmp(&extent[*b])).unwrap_or(0);
        let mut along: Vec<f32> = members.iter().map(|member| mean(member)[axis]).collect();
        let middle = along.len() / 2;
        let border = *along.select_nth_unstable_by(middle, f32::total_cmp).1;
        // Members keep the order in which they are alike; of equal ones, half.
        let below = members.iter().filter(|member| mean(member)[axis] < border).count();
        let mut equal = middle - below;
        let (first, second) = members.into_iter().partition(|member| {
            let x = Vec3::from(self.levels[member.0].means[member.1 as usize])[axis];
            let half = x == border && equal > 0;
            equal -= usize::from(half);
            x < border || half
        });
        json!({ "bound": bound, "children": [self.node(first), self.node(second)] })
    }

    /// Half the sides of the box round a Gaussian.
    fn reach(&self, (level, i): Member) -> Vec3 {
        let (model, i) = (&self.levels[level], i as usize);
        let [w, x, y, z] = model.rotations[i];
        let axes = Mat3::from_quat(Quat::from_xyzw(x, y, z, w).normalize());
        let sizes = Vec3::from(model.log_scales[i].map(f32::exp));
        let squares = Mat3::from_cols(axes.x_axis * sizes.x, axes.y_axis * sizes.y, axes.z_axis * sizes.z);
        REACH * Vec3::new(squares.row(0).length(), squares.row(1).length(), squares.row(2).length())
    }
}

#[derive(Deserialize)]
struct Levels {
    filenames: Vec<String>,
    tree: Node,
    /// Gaussians around the model, which viewers draw at every distance.
    environment: Option<String>,
}

#[derive(Deserialize)]
struct Node {
    #[serde(default)]
    children: Vec<Node>,
    #[serde(default)]
    lods: BTreeMap<String, Place>,
}

#[derive(Clone, Copy, Deserialize)]
struct Place {
    file: usize,
    offset: usize,
    count: usize,
}

/// The folders, in this one, of the levels that its `lod-meta.json` names, as far as they are named as this program names them.
pub(in super::super) fn folders_of_levels(folder: &Path) -> BTreeSet<PathBuf> {
    let text = std::fs::read(folder.join(LEVELS)).unwrap_or_default();
    let named = parsed(text).map(|levels| levels.filenames).unwrap_or_default();
    let own = |name: &str| {
        let (level, part) = name.strip_suffix("/meta.json")?.split_once('_')?;
        let number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
        (number(level) && number(part)).then(|| PathBuf::from(format!("{level}_{part}")))
    };
    named.iter().filter_map(|name| own(name)).filter(|part| folder.join(part).is_dir()).collect()
}

/// A fault of `lod-meta.json`.
fn wrong(what: impl Display) -> Fault {
    malformed(LEVELS, format!("{what}; {AGAIN}"))
}

/// The content of a `lod-meta.json`.
fn parsed(text: Vec<u8>) -> Result<Levels, Fault> {
    let text = text_of(text).map_err(|(place, what)| malformed(format!("{LEVELS}, {place}"), what))?;
    serde_json::from_str(&text).map_err(wrong)
}

/// Reads the SOG folder, within this one, whose `meta.json` has this name. Each may be named once: a long list of one folder would fill
/// any memory.
fn part<'a>(folder: &Path, name: &'a str, known: &mut BTreeSet<&'a Path>) -> Result<Parsed, Fault> {
    let path = Path::new(name);
    if !stays_within(path) || !name.ends_with("meta.json") {
        return Err(wrong(format!("{name} is not a meta.json within the folder")));
    }
    // With and without `./`, a name is that of one folder.
    let part = path.strip_prefix(".").unwrap_or(path).parent().unwrap_or(Path::new(""));
    if !known.insert(part) {
        return Err(wrong(format!("{name} is named twice")));
    }
    unpack::read_folder(&folder.join(part))
}

/// Reads a level of the model that `lod-meta.json` in this folder describes, 0 for the finest, and its environment.
pub(in super::super) fn read_level(folder: &Path, level: usize) -> Result<Parsed, Fault> {
    let path = folder.join(LEVELS);
    let text = std::fs::read(&path).map_err(|source| Fault::Io { path, source })?;
    let Levels { filenames, tree, environment } = parsed(text)?;
    let level = level.to_string();
    let mut places: BTreeMap<usize, Vec<Place>> = BTreeMap::new();
    let mut nodes = vec![&tree];
    while let Some(node) = nodes.pop() {
        nodes.extend(&node.children);
        if let Some(place) = node.lods.get(&level) {
            places.entry(place.file).or_default().push(*place);
        }
    }
    let mut whole: Option<Parsed> = None;
    let mut known = BTreeSet::new();
    for (file, mut places) in places {
        let name = filenames.get(file).ok_or_else(|| wrong(format!("there is no file {file}")))?;
        let mut part = part(folder, name, &mut known)?;
        places.sort_by_key(|place| place.offset);
        let mut kept = Vec::new();
        for Place { offset, count, .. } in places {
            let end = offset.checked_add(count).filter(|end| *end <= part.gaussians.len());
            let end = end.filter(|_| kept.last().is_none_or(|last| *last < offset));
            kept.extend(
                offset..end.ok_or_else(|| wrong(format!("{name} has no {count} Gaussians of its own at {offset}")))?,
            );
        }
        part.gaussians = part.gaussians.select(&kept);
        match &mut whole {
            None => whole = Some(part),
            Some(whole) => {
                if whole.gaussians.degree() != part.gaussians.degree() {
                    return Err(wrong(format!("{name} has SH of another degree than the files before it")));
                }
                whole.gaussians.append(&part.gaussians);
            }
        }
    }
    let mut whole = whole.ok_or_else(|| wrong(format!("no Gaussians of level {level}")))?;
    if let Some(name) = environment.as_deref().filter(|name| !name.is_empty()) {
        let around = part(folder, name, &mut known)?;
        whole.gaussians.append(&around.gaussians);
        whole.tag = Tag::of_parts([whole.tag, around.tag]);
    }
    Ok(whole)
}
