//! The container of NumPy archives: a zip file whose entries are stored (`numpy.savez`) or deflated
//! (`numpy.savez_compressed`).
//!
//! Written by hand because the library's reader trusts the sizes in the headers and allocates accordingly.

use crate::{Error, Result};
use flate2::read::DeflateDecoder;
use std::io::{self, Read, Seek, SeekFrom};

/// A file inside an archive.
pub(super) struct Entry {
    /// Name of the file.
    pub name: String,
    /// Length in bytes.
    pub size: u64,
    /// Length in the archive in bytes.
    packed: u64,
    /// [`STORED`], [`DEFLATED`] or a method that is not supported.
    method: u16,
    crc: u32,
    header: u64,
}

/// An archive. Sizes and offsets are checked against its length before they are used.
pub(super) struct Archive<R> {
    reader: R,
    len: u64,
    origin: String,
    /// Entries in the order of the directory.
    pub entries: Vec<Entry>,
}

const END: u32 = 0x0605_4b50;
const END64: u32 = 0x0606_4b50;
const END64_LOCATOR: u32 = 0x0706_4b50;
const CENTRAL: u32 = 0x0201_4b50;
const LOCAL: u32 = 0x0403_4b50;
/// Methods of compression.
const STORED: u16 = 0;
const DEFLATED: u16 = 8;
/// Most bytes that one byte of a deflated entry stands for.
const DEFLATES: u64 = 1032;
/// Lengths of the fixed parts of the records.
const END_LEN: usize = 22;
const CENTRAL_LEN: usize = 46;
const LOCAL_LEN: u64 = 30;

/// Returns a little-endian field of a record, or `None` if it lies past the end.
fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}
fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}
fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(*bytes.get(at..)?.first_chunk()?))
}

impl<R: Read + Seek> Archive<R> {
    /// Reads the directory of an archive of `len` bytes; `origin` names it in errors.
    pub fn open(reader: R, len: u64, origin: String) -> Result<Self> {
        let mut archive = Self { reader, len, origin, entries: Vec::new() };
        let entries =
            archive.directory().transpose().unwrap_or_else(|| Err(io::Error::other("a damaged one")));
        archive.entries =
            entries.map_err(|e| Error::invalid(&archive.origin, "archive", "a directory of entries", e))?;
        Ok(archive)
    }

    /// Reads the directory. Returns `Ok(None)` if it is damaged.
    fn directory(&mut self) -> io::Result<Option<Vec<Entry>>> {
        let tail_len = self.len.min((END_LEN + usize::from(u16::MAX)) as u64);
        let tail = self.bytes(self.len - tail_len, tail_len)?;
        let is_end = |&at: &usize| {
            u32_at(&tail, at) == Some(END)
                && u16_at(&tail, at + 20)
                    .is_some_and(|comment| at + END_LEN + usize::from(comment) == tail.len())
        };
        let Some(at) = (0..tail.len()).rev().find(is_end) else { return Ok(None) };
        let (Some(size), Some(start)) = (u32_at(&tail, at + 12), u32_at(&tail, at + 16)) else {
            return Ok(None);
        };
        let (mut size, mut start) = (u64::from(size), u64::from(start));
        if let Some(locator) = at.checked_sub(20).filter(|&l| u32_at(&tail, l) == Some(END64_LOCATOR)) {
            let Some(place) =
                u64_at(&tail, locator + 8).filter(|p| p.checked_add(56).is_some_and(|e| e <= self.len))
            else {
                return Ok(None);
            };
            let end = self.bytes(place, 56)?;
            match (u32_at(&end, 0), u64_at(&end, 40), u64_at(&end, 48)) {
                (Some(END64), Some(s), Some(o)) => (size, start) = (s, o),
                _ => return Ok(None),
            }
        }
        if start.checked_add(size).is_none_or(|end| end > self.len) {
            return Ok(None);
        }
        let bytes = self.bytes(start, size)?;
        let mut entries = Vec::new();
        let mut rest = &bytes[..];
        while !rest.is_empty() {
            let Some((entry, used)) = central_entry(rest) else { return Ok(None) };
            entries.push(entry);
            rest = &rest[used..];
        }
        Ok(Some(entries))
    }

    /// Reads `len` bytes at offset `at`. The caller must have checked that they lie within the file.
    fn bytes(&mut self, at: u64, len: u64) -> io::Result<Vec<u8>> {
        let mut out = vec![0; len as usize];
        self.reader.seek(SeekFrom::Start(at))?;
        self.reader.read_exact(&mut out)?;
        Ok(out)
    }

    /// Returns a reader of the entry `name`, and its size in bytes. The reader fails at the end if the
    /// checksum does not match.
    pub fn entry(&mut self, name: &str) -> Result<(Checked<'_>, u64)> {
        let bad = |expected: &str, found: &dyn std::fmt::Display| {
            Error::invalid(&self.origin, name, expected, found)
        };
        let found = self.entries.iter().find(|e| e.name == name);
        let entry = found.ok_or_else(|| bad("an array of this name", &"none"))?;
        let &Entry { header, size, packed, method, crc, .. } = entry;
        match method {
            STORED if packed == size => {}
            DEFLATED if size <= packed.saturating_mul(DEFLATES) => {}
            STORED | DEFLATED => return Err(bad("a possible size", &format!("{size} bytes in {packed}"))),
            _ => {
                let expected = "a stored or deflated array, as NumPy writes it";
                return Err(bad(expected, &format!("compression method {method}")));
            }
        }
        let inside = |from: u64, len: u64| from.checked_add(len).filter(|&end| end <= self.len);
        inside(header, LOCAL_LEN).ok_or_else(|| bad("a place inside the archive", &header))?;
        let local = self.bytes(header, LOCAL_LEN).map_err(|e| Error::io(&self.origin, "cannot read", e))?;
        let start = match (u32_at(&local, 0), u16_at(&local, 26), u16_at(&local, 28)) {
            (Some(LOCAL), Some(name), Some(extra)) => header + LOCAL_LEN + u64::from(name) + u64::from(extra),
            _ => return Err(Error::invalid(&self.origin, name, "an entry at its place", "something else")),
        };
        if start.checked_add(packed).is_none_or(|end| end > self.len) {
            return Err(Error::invalid(&self.origin, name, format!("{packed} bytes"), "the end of the file"));
        }
        self.reader.seek(SeekFrom::Start(start)).map_err(|e| Error::io(&self.origin, "cannot read", e))?;
        let stored = (&mut self.reader).take(packed);
        let reader: Box<dyn Read + '_> =
            if method == DEFLATED { Box::new(DeflateDecoder::new(stored)) } else { Box::new(stored) };
        Ok((Checked { reader, left: size, sum: crc32fast::Hasher::new(), crc }, size))
    }
}

/// Parses a record of the central directory. Also returns its length.
fn central_entry(bytes: &[u8]) -> Option<(Entry, usize)> {
    if u32_at(bytes, 0)? != CENTRAL {
        return None;
    }
    let method = u16_at(bytes, 10)?;
    let mut sizes = [u32_at(bytes, 24)?, u32_at(bytes, 20)?, u32_at(bytes, 42)?].map(u64::from);
    let [name, extra, comment] =
        [u16_at(bytes, 28)?, u16_at(bytes, 30)?, u16_at(bytes, 32)?].map(usize::from);
    let mut fields = bytes.get(CENTRAL_LEN + name..CENTRAL_LEN + name + extra)?;
    while let (Some(tag), Some(len)) = (u16_at(fields, 0), u16_at(fields, 2)) {
        let body = fields.get(4..4 + usize::from(len))?;
        if tag == 1 {
            // The fields that do not fit into 32 bits, in this order.
            let marked = sizes.iter_mut().filter(|s| **s == u64::from(u32::MAX));
            for (k, size) in marked.enumerate() {
                *size = u64_at(body, 8 * k)?;
            }
        }
        fields = &fields[4 + usize::from(len)..];
    }
    let [size, packed, header] = sizes;
    let used = CENTRAL_LEN + name + extra + comment;
    let entry = Entry {
        name: String::from_utf8_lossy(bytes.get(CENTRAL_LEN..CENTRAL_LEN + name)?).into_owned(),
        size,
        packed,
        method,
        crc: u32_at(bytes, 16)?,
        header,
    };
    (used <= bytes.len()).then_some((entry, used))
}

/// A reader that verifies a checksum once everything is read.
pub(super) struct Checked<'a> {
    reader: Box<dyn Read + 'a>,
    left: u64,
    sum: crc32fast::Hasher,
    crc: u32,
}

impl Read for Checked<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.left.min(buffer.len() as u64) as usize;
        let n = self.reader.read(&mut buffer[..n])?;
        self.left -= n as u64;
        self.sum.update(&buffer[..n]);
        if self.left == 0 && n > 0 && self.sum.clone().finalize() != self.crc {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "bytes that do not match their checksum"));
        }
        Ok(n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Concatenates numbers, each given with its length in bytes.
    fn record(numbers: &[(u64, usize)]) -> Vec<u8> {
        numbers.iter().flat_map(|&(number, bytes)| number.to_le_bytes()[..bytes].to_vec()).collect()
    }

    /// Returns an archive with one entry `a`, all of whose sizes and offsets are in 64-bit fields, and the
    /// offset of its directory.
    fn large_archive(data: &[u8]) -> (Vec<u8>, usize) {
        let (elsewhere, crc, size) =
            (u64::from(u32::MAX), u64::from(crc32fast::hash(data)), data.len() as u64);
        // Signature, version, flags, method and time; checksum and sizes; lengths of name and extra fields.
        let what = [(crc, 4), (elsewhere, 4), (elsewhere, 4), (1, 2)];
        let mut file = record(&[(LOCAL.into(), 4), (45, 2), (0, 8)]);
        file.extend(record(&[&what[..], &[(0, 2)]].concat()));
        file.extend([b"a", data].concat());
        let directory = file.len();
        file.extend(record(&[(CENTRAL.into(), 4), (45, 2), (45, 2), (0, 8)]));
        file.extend(record(&[&what[..], &[(28, 2), (0, 8), (0, 2), (elsewhere, 4)]].concat()));
        file.push(b'a');
        file.extend(record(&[(1, 2), (24, 2), (size, 8), (size, 8), (0, 8)]));
        let (begin, end) = (directory as u64, file.len() as u64);
        file.extend(record(&[(END64.into(), 4), (44, 8), (45, 2), (45, 2), (0, 8), (1, 8), (1, 8)]));
        file.extend(record(&[(end - begin, 8), (begin, 8)]));
        file.extend(record(&[(END64_LOCATOR.into(), 4), (0, 4), (end, 8), (1, 4)]));
        file.extend(record(&[
            (END.into(), 4),
            (0, 4),
            (1, 2),
            (1, 2),
            (elsewhere, 4),
            (elsewhere, 4),
            (0, 2),
        ]));
        (file, directory)
    }

    #[test]
    fn sizes_and_places_of_64_bits_are_read_and_other_compression_is_refused() {
        let (mut file, directory) = large_archive(b"data");
        let open = |file: &[u8]| Archive::open(io::Cursor::new(file.to_vec()), file.len() as u64, "x".into());
        let mut data = Vec::new();
        open(&file).unwrap().entry("a").unwrap().0.read_to_end(&mut data).unwrap();
        assert_eq!(data, b"data");
        file[directory + 10] = 12;
        let error = open(&file).unwrap().entry("a").err().expect("a compressed entry").to_string();
        assert!(error.contains("stored or deflated") && error.contains("compression method 12"), "{error}");
    }

    #[test]
    fn a_deflated_entry_is_no_longer_than_it_can_be() {
        let mut deflated = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::best());
        std::io::Write::write_all(&mut deflated, &[7; 1000]).unwrap();
        let packed = deflated.finish().unwrap();
        let open = |size: u64, crc: u32| {
            let entry = |header| Entry {
                name: "a".into(),
                size,
                packed: packed.len() as u64,
                method: DEFLATED,
                crc,
                header,
            };
            let file = [&LOCAL.to_le_bytes()[..], &[0; 26], &packed].concat();
            let (len, origin) = (file.len() as u64, "x".into());
            Archive { reader: io::Cursor::new(file), len, origin, entries: vec![entry(0)] }
        };
        let crc = crc32fast::hash(&[7; 1000]);
        let mut data = Vec::new();
        open(1000, crc).entry("a").unwrap().0.read_to_end(&mut data).unwrap();
        assert_eq!(data, [7; 1000]);
        let mut read = |size, crc| open(size, crc).entry("a").unwrap().0.read_to_end(&mut data).map(drop);
        assert!(read(1000, !crc).unwrap_err().to_string().contains("checksum"));
        let error = open(1 << 40, crc).entry("a").err().expect("an impossible size").to_string();
        assert!(error.contains("1099511627776 bytes in"), "{error}");
    }
}
