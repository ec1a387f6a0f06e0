//! Photos found by names that differ from theirs.

use std::cell::OnceCell;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::names::{key, last, relative, tidy};
use super::tree::PhotoTree;

/// All photos below a folder, without what only looks like them ([`PhotoTree`]), found by names that differ from theirs in case, in the composition of letters, in
/// extensions, or in the folders of the machine that wrote them.
pub(super) struct Lookup {
    folder: PathBuf,
    files: OnceCell<Files>,
}

#[derive(Default)]
struct Files {
    /// All lie in the folder itself.
    flat: bool,
    /// Paths within the folder, by key.
    whole: HashMap<String, Vec<String>>,
    /// The same, by the key's last part.
    last: HashMap<String, Vec<String>>,
}

impl Lookup {
    /// Reads the folder when it is first needed.
    pub fn of(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), files: OnceCell::new() }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The path within the folder of the only photo that can be meant by `name`, which may be written as in a URL.
    pub fn find(&self, name: &str) -> Option<String> {
        self.found(name).or_else(|| self.found(&unescaped(name)?))
    }

    fn found(&self, name: &str) -> Option<String> {
        let files = self.files.get_or_init(|| Files::of(&self.folder));
        let foreign = name.starts_with(['/', '\\']) || tidy(name).starts_with("../") || relative(name) != tidy(name);
        let key = key(&relative(name));
        let mut rest = key.as_str();
        loop {
            if let Some(found) = files.whole.get(rest) {
                return one(found, name);
            }
            // Folders of another machine say nothing; those within a capture tell photos of several cameras apart.
            match rest.split_once('/') {
                Some((_, inner)) if foreign || files.flat => rest = inner,
                None if rest == key => return files.last.get(rest).and_then(|found| one(found, name)),
                _ => return None,
            }
        }
    }
}

impl Files {
    fn of(folder: &Path) -> Self {
        let mut files = Self { flat: true, ..Self::default() };
        for name in PhotoTree::whole(folder).names {
            let key = key(&name);
            files.flat &= !name.contains('/');
            files.last.entry(last(&key).to_owned()).or_default().push(name.clone());
            files.whole.entry(key).or_default().push(name);
        }
        files
    }
}

/// A name with the bytes that it writes as %20; none if it writes none so.
fn unescaped(name: &str) -> Option<String> {
    let (mut bytes, mut rest) = (Vec::new(), name.as_bytes());
    while let Some((first, more)) = rest.split_first() {
        let code = more.get(..2).and_then(|hex| u8::from_str_radix(std::str::from_utf8(hex).ok()?, 16).ok());
        let (byte, after) = if *first == b'%'
            && let Some(code) = code
        {
            (code, &more[2..])
        } else {
            (*first, more)
        };
        bytes.push(byte);
        rest = after;
    }
    String::from_utf8(bytes).ok().filter(|plain| plain != name)
}

/// The only file, or the only one with the extension of `name`; of several, the only one in the folder images.
fn one(found: &[String], name: &str) -> Option<String> {
    let extension = |name: &str| name.rsplit_once('.').map(|(_, e)| e.to_ascii_lowercase());
    let same: Vec<&String> = found.iter().filter(|file| extension(file) == extension(name)).collect();
    let among = if same.is_empty() { found.iter().collect() } else { same };
    let usual = among.iter().copied().filter(|file| file.to_ascii_lowercase().starts_with("images/"));
    let only = |files: Vec<&String>| if let [only] = files[..] { Some(only.clone()) } else { None };
    only(among.clone()).or_else(|| only(usual.collect()))
}
