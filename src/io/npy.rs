//! NumPy arrays (`.npy`).

use super::{clip::Clip, open};
use crate::{Error, Result, memory};
use half::f16;
use ndarray::{ArrayD, IxDyn, ShapeBuilder};
use std::{
    borrow::Cow,
    io::{self, BufReader, Read, Write},
    path::Path,
};

/// Supported element types.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Element {
    F16,
    F32,
    F64,
    I16,
    U16,
    I32,
    I64,
    U32,
    U64,
}

impl Element {
    fn bytes(self) -> usize {
        match self {
            Self::F16 | Self::I16 | Self::U16 => 2,
            Self::F32 | Self::I32 | Self::U32 => 4,
            Self::F64 | Self::I64 | Self::U64 => 8,
        }
    }

    /// Returns the name of the type in a header, after the character of the byte order.
    fn name(self) -> &'static str {
        match self {
            Self::F16 => "f2",
            Self::F32 => "f4",
            Self::F64 => "f8",
            Self::I16 => "i2",
            Self::U16 => "u2",
            Self::I32 => "i4",
            Self::I64 => "i8",
            Self::U32 => "u4",
            Self::U64 => "u8",
        }
    }

    /// Parses the type in a header, as in `<f4`. Also returns whether its bytes are in big-endian order.
    fn parse(descr: &str) -> Option<(Self, bool)> {
        let (order, name) = descr.split_at_checked(1)?;
        use Element::*;
        let all = [F16, F32, F64, I16, U16, I32, I64, U32, U64];
        let element = all.into_iter().find(|element| element.name() == name)?;
        matches!(order, "<" | ">").then_some((element, order == ">"))
    }
}

/// An array in a file whose header has been read and checked, but not its elements.
pub(super) struct Array<R> {
    reader: R,
    origin: String,
    element: Element,
    big_endian: bool,
    fortran: bool,
    /// Lengths of the axes.
    pub shape: Vec<usize>,
    len: usize,
}

/// A type of elements that are written, in little-endian order.
pub(super) trait Number: Copy {
    /// Its name in a header, after the character of the byte order.
    const NAME: &str;
    /// Appends its bytes.
    fn put(self, bytes: &mut Vec<u8>);
}

impl Number for f32 {
    const NAME: &str = "f4";
    fn put(self, bytes: &mut Vec<u8>) {
        bytes.extend(self.to_le_bytes());
    }
}

impl Number for f64 {
    const NAME: &str = "f8";
    fn put(self, bytes: &mut Vec<u8>) {
        bytes.extend(self.to_le_bytes());
    }
}

impl Number for f16 {
    const NAME: &str = "f2";
    fn put(self, bytes: &mut Vec<u8>) {
        bytes.extend(self.to_le_bytes());
    }
}

impl Number for i32 {
    const NAME: &str = "i4";
    fn put(self, bytes: &mut Vec<u8>) {
        bytes.extend(self.to_le_bytes());
    }
}

/// Bytes that are written at a time.
const CHUNK: usize = 1 << 16;

/// Writes an array in C order. Panics if it does not have as many elements as its shape.
pub(super) fn write<T: Number>(
    writer: &mut impl Write,
    shape: &[usize],
    values: impl ExactSizeIterator<Item = T>,
) -> io::Result<()> {
    assert_eq!(values.len(), shape.iter().product::<usize>(), "{shape:?}");
    write_header::<T>(writer, shape)?;
    let mut bytes = Vec::new();
    for value in values {
        value.put(&mut bytes);
        if bytes.len() >= CHUNK {
            writer.write_all(&bytes)?;
            bytes.clear();
        }
    }
    writer.write_all(&bytes)
}

/// Writes the positions of a clip, [F, V, 3].
pub(super) fn write_positions(clip: &Clip, writer: &mut impl Write) -> io::Result<()> {
    write_frames(clip, writer, |frame| clip.frames.positions_of(frame))
}

/// Writes an array of what `of` returns for each frame, [F, V, 3].
pub(super) fn write_frames<'a>(
    clip: &Clip,
    writer: &mut impl Write,
    of: impl Fn(usize) -> io::Result<Cow<'a, [[f32; 3]]>>,
) -> io::Result<()> {
    let shape = [clip.count(), clip.topology.vertices(), 3];
    if clip.options.half {
        write_header::<f16>(writer, &shape)?
    } else {
        write_header::<f32>(writer, &shape)?
    }
    let mut bytes = Vec::new();
    for frame in 0..clip.count() {
        bytes.clear();
        for &x in of(frame)?.as_flattened() {
            if !clip.options.half {
                x.put(&mut bytes);
            } else if x.is_finite() && x.abs() > f16::MAX.to_f32() {
                let problem =
                    format!("frame {frame}: {x} is beyond the largest number of 16 bits, {}", f16::MAX);
                return Err(io::Error::new(io::ErrorKind::InvalidData, problem));
            } else {
                f16::from_f32(x).put(&mut bytes);
            }
        }
        writer.write_all(&bytes)?;
    }
    Ok(())
}

/// Writes what precedes the elements of an array in C order, in version 1.0 of the format, which every NumPy reads.
fn write_header<T: Number>(writer: &mut impl Write, shape: &[usize]) -> io::Result<()> {
    let axes: String = shape.iter().map(|length| format!("{length}, ")).collect();
    // One axis needs its comma.
    let axes = if shape.len() > 1 { axes.trim_end_matches(", ") } else { axes.trim_end() };
    let header = format!("{{'descr': '<{}', 'fortran_order': False, 'shape': ({axes}), }}", T::NAME);
    // Elements begin at a multiple of 64 bytes, after a line break.
    let end = (START.len() + 2 + header.len() + 1).next_multiple_of(64);
    let len = u16::try_from(end - START.len() - 2).map_err(io::Error::other)?;
    let mut bytes = START.to_vec();
    bytes.extend(len.to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.resize(end - 1, b' ');
    bytes.push(b'\n');
    writer.write_all(&bytes)
}

/// How a file of version 1.0 begins.
const START: &[u8; 8] = b"\x93NUMPY\x01\x00";

/// Maximum number of axes that NumPy 2 allows.
const MAX_AXES: usize = 64;
/// Maximum length of a header; that of a plain array has about 100 bytes. Guards against a bogus length.
const MAX_HEADER: u64 = 4096;

impl<R: Read> Array<R> {
    /// Reads the header of an array that occupies all `size` bytes of `reader`; `origin` names it in errors.
    pub fn open(mut reader: R, size: u64, origin: String) -> Result<Self> {
        let bad = |field: &str, expected: &str, found: &dyn std::fmt::Display| {
            Error::invalid(&origin, field, expected, found)
        };
        let cut = |_| bad("header", "a NumPy .npy array", &"the end of the data");
        let mut start = [0; 10];
        reader.read_exact(&mut start).map_err(cut)?;
        if &start[..6] != b"\x93NUMPY" {
            return Err(bad("header", "a NumPy .npy array", &"another kind of file"));
        }
        let (header_len, start_len) = match start[6] {
            1 => (u64::from(u16::from_le_bytes([start[8], start[9]])), 10),
            2 | 3 => {
                let mut high = [0; 2];
                reader.read_exact(&mut high).map_err(cut)?;
                (u64::from(u32::from_le_bytes([start[8], start[9], high[0], high[1]])), 12)
            }
            version => return Err(bad("header", "format version 1 to 3", &version)),
        };
        if header_len > size.saturating_sub(start_len).min(MAX_HEADER) {
            let expected = format!("at most {MAX_HEADER} bytes, inside the file");
            return Err(bad("header", &expected, &format!("a length of {header_len}")));
        }
        let mut header = vec![0; header_len as usize];
        reader.read_exact(&mut header).map_err(cut)?;
        let (descr, fortran, shape) = parse_header(&header)
            .ok_or_else(|| bad("header", "descr, fortran_order and shape", &"other text"))?;
        let (element, big_endian) = Element::parse(descr).ok_or_else(|| {
            bad(
                "dtype",
                "floating-point or whole numbers of 2 to 8 bytes, such as '<f4' or '<i4'",
                &format!("'{descr}'"),
            )
        })?;
        let bytes = shape.iter().try_fold(element.bytes(), |n, &axis| n.checked_mul(axis));
        let there = size.saturating_sub(start_len + header_len);
        let fits = bytes.filter(|&b| b as u64 == there);
        let Some(bytes) = fits else {
            let each = element.bytes();
            let expected = format!("the data of shape {shape:?}, {each} bytes each, and nothing else");
            return Err(bad("length", &expected, &format!("{there} bytes")));
        };
        let len = bytes / element.bytes();
        Ok(Self { reader, element, big_endian, fortran, shape, len, origin })
    }

    /// Returns this array. Fails if its elements are not floating-point numbers.
    pub fn of_floats(self) -> Result<Self> {
        match self.element {
            Element::F16 | Element::F32 | Element::F64 => Ok(self),
            whole => {
                let expected = "floating-point numbers, as in 'f2', 'f4' or 'f8'";
                Err(self.invalid("dtype", expected, format!("'{}'", whole.name())))
            }
        }
    }

    /// Creates an error about this array.
    pub fn invalid(&self, field: &str, expected: &str, found: impl ToString) -> Error {
        Error::invalid(&self.origin, field, expected, found)
    }

    /// Passes the elements to `sink` in file order.
    fn elements(&mut self, mut sink: impl FnMut(f64)) -> Result<()> {
        let mut buffer = [0; 1 << 14];
        let mut left = self.len * self.element.bytes();
        while left > 0 {
            let chunk = &mut buffer[..left.min(1 << 14)];
            left -= chunk.len();
            self.reader
                .read_exact(chunk)
                .map_err(|e| Error::invalid(&self.origin, "data", "all its elements", e))?;
            if self.big_endian {
                chunk.chunks_exact_mut(self.element.bytes()).for_each(<[u8]>::reverse);
            }
            match self.element {
                Element::F16 => words(chunk).for_each(|b| sink(f16::from_le_bytes(b).into())),
                Element::F32 => words(chunk).for_each(|b| sink(f32::from_le_bytes(b).into())),
                Element::F64 => words(chunk).for_each(|b| sink(f64::from_le_bytes(b))),
                Element::I16 => words(chunk).for_each(|b| sink(i16::from_le_bytes(b).into())),
                Element::U16 => words(chunk).for_each(|b| sink(u16::from_le_bytes(b).into())),
                Element::I32 => words(chunk).for_each(|b| sink(i32::from_le_bytes(b).into())),
                Element::I64 => words(chunk).for_each(|b| sink(i64::from_le_bytes(b) as f64)),
                Element::U32 => words(chunk).for_each(|b| sink(u32::from_le_bytes(b).into())),
                Element::U64 => words(chunk).for_each(|b| sink(u64::from_le_bytes(b) as f64)),
            }
        }
        Ok(())
    }

    /// Returns a vector with room for `len` elements. An array in a compressed archive may be longer than memory.
    fn reserved<T: Default>(&self, len: usize) -> Result<Vec<T>> {
        let mut values = Vec::new();
        let bytes = len.saturating_mul(size_of::<T>());
        let too_long = |_| self.invalid("length", "an array that fits into memory", memory::readable(bytes));
        memory::reserve(&mut values, len, "its elements").map_err(too_long)?;
        Ok(values)
    }

    /// Reads the whole array, converting each element with `cast`.
    pub fn read<T: Default>(&mut self, cast: impl Fn(f64) -> T) -> Result<ArrayD<T>> {
        let mut data = self.reserved(self.len)?;
        self.elements(|x| data.push(cast(x)))?;
        let shape = IxDyn(&self.shape).set_f(self.fortran);
        ArrayD::from_shape_vec(shape, data).map_err(|e| self.invalid("shape", "a usable shape", e))
    }

    /// Passes on an array of shape [.., 3] in C order, `count` triples at a time, until `take` fails.
    pub fn triples_at_a_time(
        &mut self,
        count: usize,
        mut take: impl FnMut(&[[f32; 3]]) -> Result<()>,
    ) -> Result<()> {
        if self.fortran || self.shape.last() != Some(&3) {
            let found = format!("{:?}{}", self.shape, if self.fortran { " in Fortran order" } else { "" });
            return Err(self.invalid("shape", "a last axis of 3, in C order", found));
        }
        let (mut numbers, mut taken) = (Vec::new(), Ok(()));
        self.elements(|x| {
            numbers.push(x as f32);
            if numbers.len() == 3 * count {
                if taken.is_ok() {
                    taken = take(numbers.as_chunks().0);
                }
                numbers.clear();
            }
        })?;
        taken
    }

    /// Reads an array of shape [.., 3] as triples in C order, converting each element with `cast`.
    pub fn triples<T: Copy + Default>(&mut self, cast: impl Fn(f64) -> T) -> Result<Vec<[T; 3]>> {
        if self.shape.last() != Some(&3) {
            return Err(self.invalid("shape", "a last axis of 3", format!("{:?}", self.shape)));
        }
        let mut out = self.reserved(self.len / 3)?;
        let mut triple = [T::default(); 3];
        let mut axis = 0;
        let mut push = |x: T| {
            triple[axis] = x;
            axis = (axis + 1) % 3;
            if axis == 0 {
                out.push(triple);
            }
        };
        if self.fortran {
            self.read(cast)?.iter().for_each(|&x| push(x));
        } else {
            self.elements(|x| push(cast(x)))?;
        }
        Ok(out)
    }
}

fn words<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [u8; N]> + '_ {
    bytes.as_chunks::<N>().0.iter().copied()
}

/// Parses the three entries of a header such as
/// `{'descr': '<f4', 'fortran_order': False, 'shape': (391, 1024, 3), }`, in any order. Returns `None` for
/// anything else.
fn parse_header(header: &[u8]) -> Option<(&str, bool, Vec<usize>)> {
    let text = str::from_utf8(header).ok()?.trim();
    let mut rest = text.strip_prefix('{')?.strip_suffix('}')?.trim();
    let (mut descr, mut fortran, mut shape) = (None, None, None);
    while !rest.is_empty() {
        let (key, after) = quoted(rest)?;
        let after = after.trim_start().strip_prefix(':')?.trim_start();
        let unread = match key {
            "descr" if descr.is_none() => {
                let (value, after) = quoted(after)?;
                descr = Some(value);
                after
            }
            "fortran_order" if fortran.is_none() => {
                let (value, after) = match after.strip_prefix("True") {
                    Some(after) => (true, after),
                    None => (false, after.strip_prefix("False")?),
                };
                fortran = Some(value);
                after
            }
            "shape" if shape.is_none() => {
                let (axes, after) = after.strip_prefix('(')?.split_once(')')?;
                shape = Some(parse_axes(axes)?);
                after
            }
            _ => return None,
        };
        let unread = unread.trim_start();
        rest = match unread.strip_prefix(',') {
            Some(after) => after.trim_start(),
            None if unread.is_empty() => unread,
            None => return None,
        };
    }
    Some((descr?, fortran?, shape?))
}

fn quoted(text: &str) -> Option<(&str, &str)> {
    let quote = text.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
    text[1..].split_once(quote)
}

/// Parses the inside of a tuple: "", "5," or "391, 1024, 3".
fn parse_axes(text: &str) -> Option<Vec<usize>> {
    let text = text.trim();
    let text = text.strip_suffix(',').unwrap_or(text);
    if text.is_empty() {
        return Some(Vec::new());
    }
    let axes: Option<Vec<usize>> = text.split(',').map(|axis| axis.trim().parse().ok()).collect();
    axes.filter(|a| a.len() <= MAX_AXES)
}

/// Reads an array of `f2`, `f4` or `f8` in C or Fortran order.
pub fn read_npy(path: impl AsRef<Path>) -> Result<ArrayD<f64>> {
    open_npy(path.as_ref())?.of_floats()?.read(|x| x)
}

/// Reads the array in the bytes of a `.npy` file like [`read_npy`]; `origin` names it in errors.
pub fn parse_npy(origin: &str, bytes: &[u8]) -> Result<ArrayD<f64>> {
    Array::open(bytes, bytes.len() as u64, origin.to_owned())?.of_floats()?.read(|x| x)
}

/// Opens a file that consists of a single array.
pub(super) fn open_npy(path: &Path) -> Result<Array<BufReader<std::fs::File>>> {
    let (file, size) = open(path)?;
    Array::open(BufReader::new(file), size, path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(header: &str, data: &[u8]) -> Result<ArrayD<f64>> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        let size = bytes.len() as u64;
        Array::open(&bytes[..], size, "test.npy".into())?.read(|x| x)
    }

    #[test]
    fn both_orders_and_widths() {
        let f4: Vec<u8> = (0..6).flat_map(|k| (k as f32).to_le_bytes()).collect();
        let f8: Vec<u8> = (0..6).flat_map(|k| (k as f64).to_le_bytes()).collect();
        let c = read("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }\n", &f4).unwrap();
        let f = read("{'shape': (2, 3), 'fortran_order': True, 'descr': '<f8'}", &f8).unwrap();
        assert_eq!(c[[1, 0]], 3.0);
        assert_eq!(f[[1, 0]], 1.0);
        let scalar = read("{'descr': '<f4', 'fortran_order': False, 'shape': (), }", &f4[4..8]).unwrap();
        assert_eq!((scalar.ndim(), scalar.sum()), (0, 1.0));
    }

    #[test]
    fn both_byte_orders() {
        let big: Vec<u8> = (0..6).flat_map(|k| (k as f32 - 0.5).to_be_bytes()).collect();
        let found = read("{'descr': '>f4', 'fortran_order': False, 'shape': (2, 3)}", &big).unwrap();
        assert_eq!(found.as_slice().unwrap(), [-0.5, 0.5, 1.5, 2.5, 3.5, 4.5]);
        let whole = read("{'descr': '>i8', 'fortran_order': False, 'shape': ()}", &(-3i64).to_be_bytes());
        assert_eq!(whole.unwrap().sum(), -3.0);
    }

    #[test]
    fn claims_are_checked_against_the_length() {
        let huge = "{'descr': '<f4', 'fortran_order': False, 'shape': (4000000000, 4000000000, 3), }";
        let error = read(huge, &[0; 12]).unwrap_err().to_string();
        assert!(error.contains("test.npy: length") && error.contains("12 bytes"), "{error}");
        let longer = "{'descr': '<f4', 'fortran_order': False, 'shape': (2,), }";
        assert!(read(longer, &[0; 9]).is_err() && read(longer, &[0; 7]).is_err());
    }

    #[test]
    fn foreign_headers_are_refused() {
        for header in [
            "",
            "{}",
            "{'descr': '<f4', 'fortran_order': False}",
            "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': ()}",
            "{'descr': '<f4', 'fortran_order': False, 'shape': (-1,)}",
            "{'descr': '|f4', 'fortran_order': False, 'shape': ()}",
            "{'descr': '<é', 'fortran_order': False, 'shape': ()}",
            "{'descr': '', 'fortran_order': False, 'shape': ()}",
            "{'descr': '<f4', 'fortran_order': False, 'shape': () 'x': 1}",
        ] {
            assert!(read(header, &[0; 4]).is_err(), "{header}");
        }
    }
}
