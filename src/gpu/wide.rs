//! Loads of 64 bits where a driver loads lane by lane.

use super::Storage;

/// A kind of element that is read as words of 64 bits.
struct Element {
    /// Names of its type in the kernels' files.
    types: &'static [&'static str],
    words: &'static str,
    /// The functions that convert from and to the words.
    of_words: &'static str,
    to_words: &'static str,
}

const ELEMENTS: [Element; 2] = [
    Element {
        types: &["vec4f", "StoredQuad"],
        words: "vec2<u64>",
        of_words: "quad_of_words",
        to_words: "words_of_quad",
    },
    Element { types: &["vec2f"], words: "u64", of_words: "pair_of_word", to_words: "word_of_pair" },
];

/// The conversions, which a compiler turns into shuffles.
const CONVERSIONS: &str = "
fn pair_of_word(v: u64) -> vec2f { return bitcast<vec2f>(vec2u(u32(v), u32(v >> 32u))); }
fn word_of_pair(v: vec2f) -> u64 { let b = bitcast<vec2u>(v); return u64(b.x) | (u64(b.y) << 32u); }
fn quad_of_words(v: vec2<u64>) -> vec4f { return vec4f(pair_of_word(v.x), pair_of_word(v.y)); }
fn words_of_quad(v: vec4f) -> vec2<u64> { return vec2<u64>(word_of_pair(v.xy), word_of_pair(v.zw)); }
";

/// Returns a kernel's text in which read-only and workgroup arrays of quads and pairs in single precision hold
/// words of 64 bits instead; stored ones are in `storage`. Line numbers do not change.
///
/// llvmpipe of Mesa 22 inserts what it loads into a vector lane by lane, each time through memory, and a
/// processor without AVX-512 stalls until that has arrived. With words there are half as many insertions.
pub(super) fn apply(text: &str, storage: Storage) -> String {
    let mut arrays = Vec::new();
    let mut declared = String::with_capacity(2 * text.len());
    for line in text.lines() {
        match declaration(line).filter(|(_, ty, _)| storage == Storage::F32 || !ty.starts_with("Stored")) {
            Some((name, ty, element)) => {
                let words = format!("array<{}", element.words);
                declared.push_str(&line.replacen(&format!("array<{ty}"), &words, 1));
                arrays.push((name, element));
            }
            None => declared.push_str(line),
        }
        declared.push('\n');
    }
    if arrays.is_empty() { declared } else { converted(&declared, &arrays) + CONVERSIONS }
}

/// Returns the name of an array to be read in words, the type of its elements and their kind, if the line
/// declares one.
fn declaration(line: &str) -> Option<(&str, &str, &'static Element)> {
    let (_, rest) = line.split_once("var<storage, read> ").or_else(|| line.split_once("var<workgroup> "))?;
    let (name, rest) = rest.split_once(": array<")?;
    let ty = rest.split([',', '>']).next()?;
    Some((name, ty, ELEMENTS.iter().find(|element| element.types.contains(&ty))?))
}

/// Returns code with a conversion around each element of `arrays` that is read, and around each value that is
/// assigned to one.
fn converted(text: &str, arrays: &[(&str, &Element)]) -> String {
    let mut out = String::with_capacity(2 * text.len());
    let mut rest = text;
    while let Some(begin) = rest.find(|c: char| c.is_ascii_alphabetic() || c == '_' || c == '/') {
        let (before, word) = rest.split_at(begin);
        if let Some(comment) = word.strip_prefix("//") {
            let (comment, after) = comment.split_at(comment.find('\n').unwrap_or(comment.len()));
            out.extend([before, "//", comment]);
            rest = after;
            continue;
        }
        out.push_str(before);
        if let Some(divisor) = word.strip_prefix('/') {
            out.push('/');
            rest = divisor;
            continue;
        }
        let (word, after) = word.split_at(word.find(|c: char| !is_of_name(c)).unwrap_or(word.len()));
        let field = before.ends_with('.') || before.ends_with(|c: char| c.is_ascii_digit());
        let array = arrays.iter().find(|array| array.0 == word && !field && after.starts_with('['));
        let Some(((_, Element { of_words, to_words, .. }), end)) = array.zip(closing(after)) else {
            out.push_str(word);
            rest = after;
            continue;
        };
        let (index, after) = after.split_at(end);
        let element = format!("{word}{}", converted(index, arrays));
        rest = match assigned(after) {
            Some((operator, value, after)) => {
                let value = match (operator, converted(value, arrays)) {
                    ("", value) => value,
                    (_, value) => format!("{of_words}({element}) {operator} ({value})"),
                };
                out.push_str(&format!("{element} = {to_words}({value});"));
                after
            }
            None => {
                out.push_str(&format!("{of_words}({element})"));
                after
            }
        };
    }
    out + rest
}

/// If `text` assigns to the element before it, returns the operator (empty unless the assignment is compound),
/// the value, and what follows its semicolon.
fn assigned(text: &str) -> Option<(&str, &str, &str)> {
    let (operator, value) = text.strip_prefix(' ')?.split_once('=')?;
    let assigns = ["", "+", "-", "*", "/"].contains(&operator) && value.starts_with([' ', '\n']);
    let (value, after) = value.trim_start_matches(' ').split_once(';').filter(|_| assigns)?;
    Some((operator, value, after))
}

fn is_of_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_'
}

/// Returns where the text after the bracket begins that closes the first one.
fn closing(text: &str) -> Option<usize> {
    let mut open = 0;
    for (at, c) in text.char_indices() {
        match c {
            '[' => open += 1,
            ']' if open == 1 => return Some(at + 1),
            ']' => open -= 1,
            _ => (),
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_are_converted_where_they_are_read_or_written() {
        let text = "@group(0) @binding(1) var<storage, read> x: array<StoredQuad>;
var<workgroup> sums: array<vec2f, N>;
// sums[k] = x[k]
fn f() { sums[k] = x[at + i[2]].xy + sums[u32(x[0].x)]; sums[0] *= 2.0; let max_x[0] = a.x[1] == sums[0]; }
";
        let wide = "@group(0) @binding(1) var<storage, read> x: array<vec2<u64>>;
var<workgroup> sums: array<u64, N>;
// sums[k] = x[k]
fn f() { sums[k] = word_of_pair(quad_of_words(x[at + i[2]]).xy + pair_of_word(sums[u32(quad_of_words(x[0]).x)])); sums[0] = word_of_pair(pair_of_word(sums[0]) * (2.0)); let max_x[0] = a.x[1] == pair_of_word(sums[0]); }
";
        assert_eq!(apply(text, Storage::F32).strip_suffix(CONVERSIONS), Some(wide));
    }

    /// Half precision is narrow on purpose; written and scalar arrays stay as they are.
    #[test]
    fn other_arrays_stay() {
        let text = "@group(0) @binding(1) var<storage, read> x: array<StoredQuad>;
@group(0) @binding(2) var<storage, read_write> y: array<vec4f>;
@group(0) @binding(3) var<storage, read> z: array<f32>;
fn f() { y[0] = vec4f(x[0]) * z[0]; }
";
        assert_eq!(apply(text, Storage::F16), text);
    }
}
