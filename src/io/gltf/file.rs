//! The parts of a glTF file: its description, which is JSON, and its buffers.

use crate::io::{Node, parse_json, read_bytes};
use crate::{Error, Result};
use serde_json::Value;
use std::collections::HashMap;
use std::path::{Component, Path};
use std::rc::Rc;

/// Extensions without which a file is another mesh, and what to do about them.
const UNREADABLE: [(&str, &str); 5] = [
    ("KHR_draco_mesh_compression", "a mesh without compression (Draco's is not readable)"),
    ("EXT_meshopt_compression", "a mesh without compression (meshopt's is not readable)"),
    ("KHR_meshopt_compression", "a mesh without compression (meshopt's is not readable)"),
    ("EXT_mesh_gpu_instancing", "a node for each instance of a mesh"),
    ("KHR_texture_transform", "texture coordinates that the material does not move (gltfpack: -noq)"),
];

/// A file and what it refers to.
pub(super) struct File {
    /// File name, for errors.
    pub origin: String,
    /// The bytes of the file and its buffers together.
    pub bytes: usize,
    document: Value,
    buffers: Vec<(Rc<Vec<u8>>, usize)>,
}

impl File {
    /// Reads a `.gltf` or `.glb` file and its buffers.
    pub fn read(path: &Path) -> Result<Self> {
        let origin = path.display().to_string();
        let bytes = read_bytes(path)?;
        let is_binary = bytes.starts_with(b"glTF");
        if !is_binary && path.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb")) {
            let found = String::from_utf8_lossy(&bytes[..bytes.len().min(4)]).into_owned();
            return Err(Error::invalid(origin, "header", "binary glTF, which begins with 'glTF'", found));
        }
        let (text, binary) = if is_binary { chunks(&bytes, &origin)? } else { (&bytes[..], None) };
        let text = str::from_utf8(text).map_err(|e| {
            Error::invalid(&origin, "text", "UTF-8", format!("byte {} of it", e.valid_up_to()))
        })?;
        let document = parse_json(&origin, text)?;
        let root = Node::root(&origin, &document);
        check(&root)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let buffers = buffers(&root, folder, binary)?;
        let bytes = bytes.len() + buffers.iter().map(|(_, len)| len).sum::<usize>();
        Ok(Self { origin, bytes, document, buffers })
    }

    /// Returns the description.
    pub fn root(&self) -> Node<'_> {
        Node::root(&self.origin, &self.document)
    }

    /// Returns element `index` of a list of the description. `by` is the field that names it.
    pub fn item<'a>(&'a self, list: &str, index: usize, by: &Node) -> Result<Node<'a>> {
        let items = self.document.get(list).and_then(Value::as_array);
        let value = items.and_then(|items| items.get(index)).ok_or_else(|| {
            by.invalid(format!("one of the {} {list}, counted from 0", items.map_or(0, Vec::len)))
        })?;
        Ok(Node { origin: &self.origin, path: format!("{list}[{index}]"), value })
    }

    /// Returns the element of a list that the field `by` names by its number.
    pub fn named<'a>(&'a self, list: &str, by: &Node) -> Result<Node<'a>> {
        self.item(list, by.count()?, by)
    }

    /// Returns the bytes of the buffer that the field `by` names.
    pub fn buffer(&self, by: &Node) -> Result<&[u8]> {
        let (bytes, len) = self.buffers.get(by.count()?).ok_or_else(|| {
            by.invalid(format!("one of the {} buffers, counted from 0", self.buffers.len()))
        })?;
        Ok(&bytes[..*len])
    }
}

/// Returns the JSON and, if there is one, the binary chunk of a `.glb`.
fn chunks<'a>(bytes: &'a [u8], origin: &str) -> Result<(&'a [u8], Option<&'a [u8]>)> {
    let word = |at: usize| {
        let word = bytes.get(at..)?.first_chunk()?;
        Some(u32::from_le_bytes(*word) as usize)
    };
    let shown = |word: Option<usize>| word.map_or("the end of the file".into(), |word| word.to_string());
    if word(4) != Some(2) {
        return Err(Error::invalid(origin, "header", "version 2 of glTF", shown(word(4))));
    }
    if word(8) != Some(bytes.len()) {
        let expected = format!("a length of {} bytes, which the file has", bytes.len());
        return Err(Error::invalid(origin, "header", expected, shown(word(8))));
    }
    let mut found = Vec::new();
    let mut at = 12;
    while at < bytes.len() {
        let (len, kind) = (word(at), bytes.get(at + 4..at + 8));
        let body = len.and_then(|len| bytes.get(at + 8..)?.get(..len));
        let (Some(kind), Some(body)) = (kind, body) else {
            let expected = format!("at most {} bytes up to the end", bytes.len().saturating_sub(at + 8));
            return Err(Error::invalid(origin, format!("chunk {}", found.len()), expected, shown(len)));
        };
        found.push((kind, body));
        at += 8 + body.len();
    }
    let Some((b"JSON", text)) = found.first() else {
        let kind = found.first().map_or("none".into(), |(kind, _)| format!("'{}'", kind.escape_ascii()));
        return Err(Error::invalid(origin, "chunk 0", "'JSON', the description", kind));
    };
    let binary = found.get(1).filter(|(kind, _)| *kind == b"BIN\0");
    Ok((text, binary.map(|(_, body)| *body)))
}

/// Checks version and extensions.
fn check(root: &Node) -> Result<()> {
    let asset = root.get("asset").ok_or_else(|| root.invalid("glTF 2, with an \"asset\""))?;
    let version = asset.get("version").ok_or_else(|| asset.invalid("a \"version\", \"2.0\""))?;
    if !version.text()?.starts_with("2.") {
        return Err(version.invalid("version 2 of glTF"));
    }
    let Some(required) = root.get("extensionsRequired") else { return Ok(()) };
    for extension in required.items()? {
        let name = extension.text()?;
        if let Some((_, instead)) = UNREADABLE.iter().find(|(known, _)| *known == name) {
            return Err(extension.invalid(*instead));
        }
    }
    Ok(())
}

/// Returns the bytes of the buffers and how many of them count.
fn buffers(root: &Node, folder: &Path, binary: Option<&[u8]>) -> Result<Vec<(Rc<Vec<u8>>, usize)>> {
    let items = root.get("buffers").map_or(Ok(Vec::new()), |buffers| buffers.items())?;
    let mut known: HashMap<&str, Rc<Vec<u8>>> = HashMap::new();
    let mut buffers = Vec::with_capacity(items.len());
    for (k, buffer) in items.iter().enumerate() {
        let len = buffer.get("byteLength").ok_or_else(|| buffer.invalid("a \"byteLength\""))?;
        let bytes = match buffer.get("uri") {
            Some(uri) => match known.get(uri.text()?) {
                Some(bytes) => bytes.clone(),
                None => {
                    let bytes = Rc::new(content(&uri, folder)?);
                    known.insert(uri.text()?, bytes.clone());
                    bytes
                }
            },
            None => {
                let binary = binary.filter(|_| k == 0).ok_or_else(|| {
                    buffer.invalid("a \"uri\" (only the first buffer of a .glb is in its binary chunk)")
                })?;
                Rc::new(binary.to_vec())
            }
        };
        let count = len.count()?;
        if count > bytes.len() {
            return Err(len.invalid(format!("at most {}, the bytes that there are", bytes.len())));
        }
        buffers.push((bytes, count));
    }
    Ok(buffers)
}

/// Returns what a URI names: the data in it, or a file in the folder.
fn content(uri: &Node, folder: &Path) -> Result<Vec<u8>> {
    let text = uri.text()?;
    if let Some(data) = text.strip_prefix("data:") {
        let coded = data.split_once(',').filter(|(kind, _)| kind.ends_with(";base64"));
        return coded.and_then(|(_, coded)| base64(coded)).ok_or_else(|| uri.invalid("data in base64"));
    }
    let expected = "a data URI, or a file in the same folder or below it";
    let name = unescaped(text).ok_or_else(|| uri.invalid(expected))?;
    let mut parts = Path::new(&name).components();
    let is_below = parts.all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if !is_below || name.is_empty() || name.contains("://") {
        return Err(uri.invalid(expected));
    }
    read_bytes(&folder.join(name))
}

/// Returns a URI without its percent signs, `a%20b` as `a b`.
fn unescaped(uri: &str) -> Option<String> {
    let mut parts = uri.split('%');
    let mut bytes = parts.next()?.as_bytes().to_vec();
    for part in parts {
        bytes.push(u8::from_str_radix(part.get(..2)?, 16).ok()?);
        bytes.extend_from_slice(&part.as_bytes()[2..]);
    }
    String::from_utf8(bytes).ok()
}

/// Decodes base64, with or without padding.
fn base64(text: &str) -> Option<Vec<u8>> {
    let digits = text.trim_end_matches('=').as_bytes();
    let mut bytes = Vec::with_capacity(digits.len() / 4 * 3 + 2);
    for group in digits.chunks(4) {
        let mut bits = 0;
        for &digit in group {
            let value = match digit {
                b'A'..=b'Z' => digit - b'A',
                b'a'..=b'z' => digit - b'a' + 26,
                b'0'..=b'9' => digit - b'0' + 52,
                b'+' => 62,
                b'/' => 63,
                _ => return None,
            };
            bits = bits << 6 | u32::from(value);
        }
        // Four digits are three bytes; a last group of two or three is one byte less than it has digits.
        let whole = (bits << (8 + 6 * (4 - group.len()))).to_be_bytes();
        bytes.extend_from_slice(&whole[..group.len().checked_sub(1).filter(|&count| count > 0)?]);
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_of_every_length() {
        for (coded, text) in [("", ""), ("TQ==", "M"), ("TWE=", "Ma"), ("TWFu", "Man"), ("TWFuZQ", "Mane")] {
            assert_eq!(base64(coded).as_deref(), Some(text.as_bytes()), "{coded}");
        }
        assert_eq!(base64("+/+/"), Some(vec![0xfb, 0xff, 0xbf]));
        for wrong in ["T", "TWFuT", "TW\n=", "T Q=", "TW=u"] {
            assert_eq!(base64(wrong), None, "{wrong:?}");
        }
    }

    #[test]
    fn uris_are_unescaped() {
        assert_eq!(unescaped("a%20b%C3%A9.bin").as_deref(), Some("a bé.bin"));
        for wrong in ["a%", "a%2", "a%zz", "%ff", "%\u{e9}"] {
            assert_eq!(unescaped(wrong), None, "{wrong}");
        }
    }
}
