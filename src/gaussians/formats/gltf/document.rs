//! The JSON of a glTF file, as far as splats need it; everything else is passed over.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;
use std::ops::Deref;

use serde::Deserialize;
use serde::de::{self, Deserializer, IgnoredAny, SeqAccess, Visitor};
use serde_json::value::RawValue;

use super::super::fault::{Fault, malformed};
use super::AGAIN;
use crate::wording::shown;

/// Most entries of a list: a short `{}` in the file is a long record in memory.
const MOST: usize = 1 << 16;

/// A list of at most [`MOST`] entries.
#[derive(Debug)]
pub(super) struct List<T>(Vec<T>);

impl<T> Default for List<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> Deref for List<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for List<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Entries<T> {
            type Value = List<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut entries: A) -> Result<List<T>, A::Error> {
                let mut list = Vec::new();
                while let Some(entry) = entries.next_element()? {
                    if list.len() == MOST {
                        return Err(de::Error::custom(format_args!("a list of more than {MOST} entries")));
                    }
                    list.push(entry);
                }
                Ok(List(list))
            }
        }
        deserializer.deserialize_seq(Entries(PhantomData))
    }
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document<'a> {
    #[serde(borrow)]
    pub asset: Asset<'a>,
    #[serde(default, rename = "extensionsUsed")]
    pub used: List<Cow<'a, str>>,
    #[serde(default, rename = "extensionsRequired")]
    pub required: List<Cow<'a, str>>,
    #[serde(default)]
    pub buffers: List<Buffer<'a>>,
    #[serde(default)]
    pub buffer_views: List<View>,
    #[serde(default)]
    pub accessors: List<Accessor>,
    #[serde(default)]
    pub meshes: List<Mesh<'a>>,
    #[serde(default)]
    pub nodes: List<Node>,
    #[serde(default)]
    pub scenes: List<Scene>,
    pub scene: Option<usize>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Asset<'a> {
    pub version: Cow<'a, str>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer<'a> {
    pub uri: Option<Cow<'a, str>>,
    pub byte_length: usize,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct View {
    pub buffer: usize,
    #[serde(default)]
    pub byte_offset: usize,
    pub byte_length: usize,
    pub byte_stride: Option<usize>,
    #[serde(default)]
    pub extensions: Compressions,
}

/// Extensions of a buffer view that change what its bytes mean.
#[derive(Debug, Default, Deserialize)]
pub(super) struct Compressions {
    #[serde(alias = "KHR_meshopt_compression", rename = "EXT_meshopt_compression")]
    pub meshopt: Option<IgnoredAny>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub buffer_view: Option<usize>,
    #[serde(default)]
    pub byte_offset: usize,
    pub component_type: u32,
    #[serde(default)]
    pub normalized: bool,
    pub count: usize,
    #[serde(rename = "type")]
    pub shape: Shape,
    pub sparse: Option<Sparse>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(super) enum Shape {
    Scalar,
    Vec2,
    Vec3,
    Vec4,
    #[serde(other)]
    Matrix,
}

#[derive(Debug, Deserialize)]
pub(super) struct Sparse {
    pub count: usize,
    pub indices: Place,
    pub values: Place,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Place {
    pub buffer_view: usize,
    #[serde(default)]
    pub byte_offset: usize,
    pub component_type: Option<u32>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Mesh<'a> {
    #[serde(borrow, default)]
    pub primitives: List<Primitive<'a>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Primitive<'a> {
    #[serde(borrow, default)]
    pub attributes: BTreeMap<Cow<'a, str>, usize>,
    pub indices: Option<usize>,
    #[serde(borrow, default)]
    pub extensions: Extensions<'a>,
    /// Data of applications, in any form.
    #[serde(borrow)]
    pub extras: Option<&'a RawValue>,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct Extensions<'a> {
    #[serde(borrow, rename = "KHR_gaussian_splatting")]
    pub splats: Option<Splats<'a>>,
    /// An early draft's name.
    #[serde(rename = "KHR_spz_gaussian_splats_compression")]
    pub spz: Option<Packed>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Splats<'a> {
    #[serde(borrow)]
    pub kernel: Option<Cow<'a, str>>,
    #[serde(borrow)]
    pub color_space: Option<Cow<'a, str>>,
    #[serde(default)]
    pub extensions: Packings,
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct Packings {
    #[serde(rename = "KHR_gaussian_splatting_compression_spz_2", alias = "KHR_gaussian_splatting_compression_spz")]
    pub spz: Option<Packed>,
}

/// A file of another format in a buffer view.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Packed {
    pub buffer_view: usize,
}

#[derive(Debug, Deserialize)]
pub(super) struct Node {
    pub mesh: Option<usize>,
    #[serde(default)]
    pub children: Vec<usize>,
    pub matrix: Option<[f64; 16]>,
    pub translation: Option<[f64; 3]>,
    pub rotation: Option<[f64; 4]>,
    pub scale: Option<[f64; 3]>,
    #[serde(default)]
    pub extensions: NodeExtensions,
}

impl Node {
    /// True if neither its mesh nor any node below it is shown.
    pub(super) fn is_hidden(&self) -> bool {
        self.extensions.visibility.as_ref().is_some_and(|visibility| visibility.visible == Some(false))
    }
}

/// Extensions of a node that change where its mesh is, and whether it is shown.
#[derive(Debug, Default, Deserialize)]
pub(super) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub instances: Option<Instances>,
    #[serde(rename = "KHR_node_visibility")]
    pub visibility: Option<Visibility>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Visibility {
    pub visible: Option<bool>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Instances {
    #[serde(default)]
    pub attributes: Copies,
}

/// Accessors of one element for each copy of a node's mesh.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(super) struct Copies {
    pub translation: Option<usize>,
    pub rotation: Option<usize>,
    pub scale: Option<usize>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Scene {
    #[serde(default)]
    pub nodes: Vec<usize>,
}

/// Parses the JSON.
pub(super) fn parse(json: &[u8]) -> Result<Document<'_>, Fault> {
    let document: Document =
        serde_json::from_slice(json).map_err(|error| malformed("JSON", format!("{error}; {AGAIN}")))?;
    if !document.asset.version.starts_with("2.") {
        let version = shown(&document.asset.version, 20);
        return Err(Fault::Unsupported(format!("glTF version {version}; version 2 is read; export it as that")));
    }
    Ok(document)
}
