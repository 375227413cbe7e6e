//! Arrays of numbers in the buffers of a glTF file.

use super::file::File;
use crate::io::Node;
use crate::{Error, Result, memory};

/// Type of a number.
#[derive(Clone, Copy, PartialEq)]
enum Number {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Number {
    /// Reads the type from the field `componentType`.
    fn read(node: &Node) -> Result<Self> {
        let kind = node.get("componentType").ok_or_else(|| node.invalid("a \"componentType\""))?;
        Ok(match kind.count()? {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return Err(kind.invalid("5120 to 5123, 5125 or 5126, which are types of numbers")),
        })
    }

    /// Number of bytes.
    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// Returns the number at the start of `bytes`, which have enough of them.
    fn of(self, bytes: &[u8]) -> f64 {
        let two = || [bytes[0], bytes[1]];
        let four = || [bytes[0], bytes[1], bytes[2], bytes[3]];
        match self {
            Self::I8 => f64::from(bytes[0] as i8),
            Self::U8 => f64::from(bytes[0]),
            Self::I16 => f64::from(i16::from_le_bytes(two())),
            Self::U16 => f64::from(u16::from_le_bytes(two())),
            Self::U32 => f64::from(u32::from_le_bytes(four())),
            Self::F32 => f64::from(f32::from_le_bytes(four())),
        }
    }

    /// Returns what 1 is in normalised integers.
    fn one(self) -> f64 {
        match self {
            Self::I8 => f64::from(i8::MAX),
            Self::U8 => f64::from(u8::MAX),
            Self::I16 => f64::from(i16::MAX),
            Self::U16 => f64::from(u16::MAX),
            Self::U32 | Self::F32 => 1.0,
        }
    }
}

/// Elements at regular distances, all of them within the bytes.
struct View<'a> {
    bytes: &'a [u8],
    stride: usize,
}

impl<'a> View<'a> {
    /// Finds `count` elements of `size` bytes where `place` says: an accessor or a part of a sparse one.
    fn find(file: &'a File, place: &Node, count: usize, size: usize) -> Result<Self> {
        let number = |node: &Node, field: &str| node.get_or(field, 0, Node::count);
        let by = place.get("bufferView").ok_or_else(|| place.invalid("a \"bufferView\""))?;
        let view = file.named("bufferViews", &by)?;
        let buffer = view.get("buffer").ok_or_else(|| view.invalid("a \"buffer\""))?;
        let all = file.buffer(&buffer)?;
        let (offset, len) = (number(&view, "byteOffset")?, number(&view, "byteLength")?);
        let bytes = all.get(offset..).and_then(|bytes| bytes.get(..len)).ok_or_else(|| {
            let expected = format!("a part of the buffer's {} bytes", all.len());
            Error::invalid(&file.origin, &view.path, expected, format!("{len} bytes from {offset} on"))
        })?;
        let stride = match view.get("byteStride") {
            Some(stride) if stride.count()? < size => {
                return Err(stride.invalid(format!("{size}, the bytes of an element, or more")));
            }
            Some(stride) => stride.count()?,
            None => size,
        };
        let offset = number(place, "byteOffset")?;
        let bytes = bytes.get(offset.min(bytes.len())..).unwrap_or_default();
        let room = if bytes.len() < size { 0 } else { (bytes.len() - size) / stride + 1 };
        if count > room {
            let expected = format!("at most {room} elements, which {} has from byte {offset} on", view.path);
            return Err(Error::invalid(&file.origin, &place.path, expected, count));
        }
        Ok(Self { bytes, stride })
    }

    fn get(&self, k: usize) -> &'a [u8] {
        &self.bytes[k * self.stride..]
    }
}

/// An array of `N` numbers in each element.
pub(super) struct Accessor<'a> {
    path: String,
    count: usize,
    number: Number,
    is_normalised: bool,
    /// Without one, every element is 0.
    dense: Option<View<'a>>,
    /// The elements that others replace, in increasing order, and these.
    sparse: Option<(Vec<usize>, View<'a>)>,
}

impl<'a> Accessor<'a> {
    /// Finds the accessor that the field `by` names, whose elements have `width` numbers.
    fn find(file: &'a File, by: &Node, width: usize) -> Result<Self> {
        let node = file.named("accessors", by)?;
        let kind = ["", "SCALAR", "VEC2", "VEC3"][width];
        match node.get("type") {
            Some(found) if found.value.as_str() == Some(kind) => {}
            found => return Err(found.as_ref().unwrap_or(&node).invalid(format!("\"type\": \"{kind}\""))),
        }
        let number = Number::read(&node)?;
        let count = node.get("count").ok_or_else(|| node.invalid("a \"count\""))?;
        let (many, size) = (count.count()?, width * number.size());
        let dense = match node.get("bufferView") {
            Some(_) => Some(View::find(file, &node, many, size)?),
            // It is for parts of a mesh that others fill.
            None if many > file.bytes => {
                let expected =
                    format!("a \"bufferView\", or at most {} elements, one for each byte", file.bytes);
                return Err(count.invalid(expected));
            }
            None => None,
        };
        let sparse = match node.get("sparse") {
            Some(sparse) => Some(Self::sparse(file, &sparse, many, size)?),
            None => None,
        };
        let is_normalised = node.get_or("normalized", false, Node::flag)?;
        Ok(Self { path: node.path, count: many, number, is_normalised, dense, sparse })
    }

    /// Finds the elements that replace some of `count` others.
    fn sparse(file: &'a File, node: &Node, count: usize, size: usize) -> Result<(Vec<usize>, View<'a>)> {
        let part = |field| node.get(field).ok_or_else(|| node.invalid(format!("\"{field}\"")));
        let many = part("count")?.count()?;
        let (indices, values) = (part("indices")?, part("values")?);
        let number = Number::read(&indices)?;
        let view = View::find(file, &indices, many, number.size())?;
        let values = View::find(file, &values, many, size)?;
        let mut places = Vec::new();
        memory::reserve(&mut places, many, &file.origin)?;
        for k in 0..many {
            let place = number.of(view.get(k));
            let least = places.last().map_or(0, |last| last + 1);
            if !(place >= least as f64 && place < count as f64) {
                let expected = format!("elements below {count} in increasing order");
                return Err(Error::invalid(&file.origin, &indices.path, expected, place));
            }
            places.push(place as usize);
        }
        Ok((places, values))
    }

    /// Returns numbers of an element.
    fn element<const N: usize>(&self, k: usize) -> [f64; N] {
        let replaced = self.sparse.as_ref().and_then(|(places, values)| {
            let which = places.binary_search(&k).ok()?;
            Some(values.get(which))
        });
        let Some(bytes) = replaced.or_else(|| Some(self.dense.as_ref()?.get(k))) else { return [0.0; N] };
        std::array::from_fn(|c| {
            let number = self.number.of(&bytes[c * self.number.size()..]);
            if self.is_normalised { (number / self.number.one()).max(-1.0) } else { number }
        })
    }
}

/// Reads vectors of `N` numbers, 2 or 3, which may be integers. The field `by` names the accessor.
pub(super) fn vectors<const N: usize>(file: &File, by: &Node) -> Result<Vec<[f64; N]>> {
    let accessor = Accessor::find(file, by, N)?;
    let mut vectors: Vec<[f64; N]> = Vec::new();
    // Arrays of a length that is not known here have no default.
    memory::check(accessor.count.saturating_mul(size_of::<[f64; N]>()), &file.origin)?;
    vectors.extend((0..accessor.count).map(|k| accessor.element(k)));
    Ok(vectors)
}

/// Reads the numbers of vertices, which have to be below `vertices`. The field `by` names the accessor.
pub(super) fn indices(file: &File, by: &Node, vertices: usize) -> Result<Vec<u32>> {
    let accessor = Accessor::find(file, by, 1)?;
    if !matches!(accessor.number, Number::U8 | Number::U16 | Number::U32) {
        let expected = "5121, 5123 or 5125, which are whole numbers";
        let field = format!("{}.componentType", accessor.path);
        return Err(Error::invalid(&file.origin, field, expected, "another"));
    }
    let mut indices = Vec::new();
    memory::reserve(&mut indices, accessor.count, &file.origin)?;
    for k in 0..accessor.count {
        let [index] = accessor.element(k);
        // Compared as it is read: normalised ones are no numbers of vertices.
        if index >= vertices as f64 || index.fract() != 0.0 {
            let field = format!("{}, element {k}", accessor.path);
            let expected = format!("the number of a vertex, below {vertices}");
            return Err(Error::invalid(&file.origin, field, expected, index));
        }
        indices.push(index as u32);
    }
    Ok(indices)
}
