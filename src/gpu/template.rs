//! The WGSL of a kernel, and how its text is generated from its file: a line with a marker stands for several
//! lines.
//!
//! | marker | stands for | the line is written |
//! |---|---|---|
//! | `$c` | an output of the invocation: a channel of its tile at one of its positions | once per output |
//! | `$o`, `$x` | together with `$c`: the output's channel in the tile, its position | |
//! | `$q`, `$e` | together with `$c`: the quad that contains the channel, its element there (`x` to `w`) | |
//! | `$q` | a quad of channels of the tile | once per quad |
//! | `$x` | a position | once per position |
//! | `$q`, `$x` | a quad of channels at a position | once per quad and position |
//! | `$k` | an output of the second tile | once per output |
//! | `$8` | 0 to 7 | eight times, also for each `$k` |
//! | `$4` | 0 to 3 | four times, with all copies of other markers |
//! | `$n`, `$m` | number of channels of the tile, of its quads | |
//! | `$t` | number of outputs of the second tile | |
//! | `$same(array[index])` | an operand shared by a subgroup: apart from the line's marker it depends on nothing that varies within the subgroup, all of whose invocations reach the line ([`Sharing`]) | |
//! | `$lane` | the last parameter of an entry point with such operands | |
//! | `$space0`, `$length0`, `$space1`, `$length1` | address spaces of two operands, and lengths of their arrays if these are fixed ([`Unroll::uniforms`]) | |
//!
//! Lines between `#if broadcast` and `#endif` are left out unless operands are broadcast ([`Sharing`]); those
//! after an `#else` are left out if they are. `#if texels` does the same for [`Unroll::texels`].
//!
//! `StoredQuad` is four numbers in the storage format of the network's activations and weights ([`Storage`]),
//! and `$texels` the format of texels to which they are written.
//!
//! Accumulators thus become named registers: neither naga nor software drivers reliably turn a private array
//! into registers. The copies of a line share one line of the text, so that line numbers in messages are
//! those of the file.

use super::{Order, Storage, wide};
use std::fmt::Write;

/// The WGSL text of one kernel: the file itself, then the shared functions it calls.
///
/// Shared text is appended, so that line numbers in messages are those of the kernel's file.
#[derive(Clone, Copy, Debug)]
pub struct Source {
    /// Stem of the file, and name of the entry point.
    pub name: &'static str,
    /// Text of the file.
    pub wgsl: &'static str,
    /// Texts of files that hold only functions and constants (`shaders/common`), or code that depends on the
    /// kernel's bindings (`shaders/pieces`).
    pub appended: &'static [&'static str],
}

/// How a kernel's text is generated from its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unroll {
    /// Channels of an invocation's outputs; 0 if the kernel has no tile.
    pub tile: usize,
    /// Positions at which an invocation computes all of these channels.
    pub span: usize,
    /// Outputs of the second tile, in kernels that have one.
    pub second: usize,
    /// How operands are read whose address is the same in all invocations of a subgroup.
    pub sharing: Sharing,
    /// Elements of operands that are bound as uniform buffers; 0 for those bound as storage.
    pub uniforms: [usize; 2],
    /// Whether operands are texels, in kernels with sections for that.
    pub texels: bool,
    /// Element type of `StoredQuad`; taken from the context when a kernel is built.
    pub storage: Storage,
    /// How invocations are numbered; taken from the context when a kernel is built.
    pub order: Order,
}

impl From<usize> for Unroll {
    fn from(tile: usize) -> Self {
        Self {
            tile,
            span: 1,
            second: 1,
            sharing: Sharing::Loads,
            uniforms: [0; 2],
            texels: false,
            storage: Storage::F32,
            order: Order::Natural,
        }
    }
}

/// How operands are read whose address is the same in all invocations of a subgroup.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sharing {
    /// Every invocation loads them. Hardware serves equal addresses at once.
    Loads,
    /// Eight invocations each load one of eight operands and broadcast it ([`wgpu::Features::SUBGROUP`], in
    /// subgroups of exactly eight). Software drivers load lane by lane, so this takes an eighth of the loads,
    /// and half of those with words of 64 bits ([`wgpu::Features::SHADER_INT64`]).
    Broadcast,
}

/// The markers that repeat a line. But for the pairs in the table above, the first of them that a line contains determines the number of
/// copies.
/// `$c` goes first, as it brings others along.
const REPEATING: [&str; 5] = ["$c", "$q", "$x", "$k", "$8"];

/// Lanes over which [`Sharing::Broadcast`] spreads loads: a whole subgroup.
pub const LANES: usize = 8;

impl Source {
    /// Returns the whole text, unrolled.
    ///
    /// Panics if a line has a `$same(` but does not end with `);`.
    pub fn unrolled(&self, unroll: impl Into<Unroll>) -> String {
        let unroll = unroll.into();
        let mut text = String::with_capacity(2 * self.wgsl.len());
        let stores = self.wgsl.contains("StoredQuad");
        if stores && unroll.storage == Storage::F16 {
            text.push_str("enable f16; ");
        }
        for line in included(self.wgsl, unroll) {
            text.push_str(&self.unrolled_line(line, unroll));
            text.push('\n');
        }
        if stores {
            let name = unroll.storage.name();
            let _ = writeln!(text, "alias StoredQuad = vec4<{name}>;");
        }
        for line in self.appended.iter().flat_map(|part| included(part, unroll)) {
            text.push_str(&line.replace("$texels", &format!("rgba{}float", 8 * unroll.storage.bytes())));
            text.push('\n');
        }
        if unroll.sharing == Sharing::Broadcast {
            text = wide::apply(&text, unroll.storage);
        }
        unroll.order.apply(text, self.name)
    }

    /// Returns all copies of a line, joined into one line.
    fn unrolled_line(&self, line: &str, unroll: Unroll) -> String {
        let Unroll { tile, span, second, sharing, uniforms, .. } = unroll;
        if line.contains("$4") {
            let of_four = |k: usize| self.unrolled_line(&line.replace("$4", &k.to_string()), unroll);
            return (0..4).map(of_four).collect::<Vec<_>>().join(" ");
        }
        if line.contains("$q") && line.contains("$x") && !line.contains("$c") {
            let at_place = |place: usize| self.unrolled_line(&line.replace("$x", &place.to_string()), unroll);
            return (0..span).map(at_place).collect::<Vec<_>>().join(" ");
        }
        if line.contains("$k") && line.contains("$8") {
            let of_output = |k: usize| self.unrolled_line(&line.replace("$k", &k.to_string()), unroll);
            return (0..second).map(of_output).collect::<Vec<_>>().join(" ");
        }
        let times = [tile * span, tile / 4, span, second, 8];
        let marker = REPEATING.iter().zip(times).find(|(marker, _)| line.contains(**marker));
        let copies: Vec<String> = match (marker, line.split_once("$same(")) {
            (None, _) => vec![line.to_owned()],
            (Some((_, times)), None) => vec![line.to_owned(); times],
            (Some((_, times)), Some((target, operand))) => self.shared(target, operand, times, sharing),
        };
        let numbered = |(copy, line): (usize, &String)| match marker {
            Some((&"$c", _)) => of_output(line, copy, span),
            Some(_) => with_number(line, &copy.to_string()),
            None => line.clone(),
        };
        let lane = match sharing {
            Sharing::Loads => "",
            Sharing::Broadcast => ", @builtin(subgroup_invocation_id) lane: u32",
        };
        let line = copies.iter().enumerate().map(numbered).collect::<Vec<_>>().join(" ");
        let line = line.replace("$n", &format!("{tile}u")).replace("$m", &format!("{}u", tile / 4));
        let bound = |line: String, (operand, &elements): (usize, &usize)| {
            let (space, length) = match elements {
                0 => ("storage, read", String::new()),
                _ => ("uniform", format!(", {elements}")),
            };
            line.replace(&format!("$space{operand}"), space).replace(&format!("$length{operand}"), &length)
        };
        let line = uniforms.iter().enumerate().fold(line, bound);
        line.replace("$t", &format!("{second}u")).replace("$lane", lane)
    }

    /// Returns the copies of `target$same(operand`, where the operand ends with `);`.
    fn shared(&self, target: &str, operand: &str, times: usize, sharing: Sharing) -> Vec<String> {
        let Some(operand) = operand.strip_suffix(");") else {
            panic!("{}.wgsl: expected $same(array[index]);, found {operand}", self.name)
        };
        let name = target.trim_start().trim_start_matches("let ").split('$').next().unwrap_or_default();
        let copy = |k: usize| match sharing {
            Sharing::Loads => format!("{target}{operand};"),
            Sharing::Broadcast => {
                let (from, first) = (k % LANES, k - k % LANES);
                let held = format!("{name}_held{first}");
                let last = LANES.min(times - first) - 1;
                let own = format!("({first}u + min(lane % {LANES}u, {last}u))");
                let load = match from {
                    0 => format!("let {held} = {};", with_number(operand, &own)),
                    _ => String::new(),
                };
                format!("{load}{target}subgroupBroadcast({held}, {from}u);")
            }
        };
        (0..times).map(copy).collect()
    }
}

/// Returns the lines of a text, with empty ones in place of sections that are left out and their limits.
fn included(text: &str, unroll: Unroll) -> impl Iterator<Item = &str> {
    let mut included = true;
    text.lines().map(move |line| {
        match line {
            "#if broadcast" => included = unroll.sharing == Sharing::Broadcast,
            "#if texels" => included = unroll.texels,
            "#else" => included = !included,
            "#endif" => included = true,
            line if included => return line,
            _ => (),
        }
        ""
    })
}

/// Returns the copy of a line for one output. `copy` counts the positions of the first channel, then those of
/// the next.
fn of_output(line: &str, copy: usize, span: usize) -> String {
    let (channel, place) = (copy / span, copy % span);
    let (quad, element) = (channel / 4, ["x", "y", "z", "w"][channel % 4]);
    let numbers = [("$c", copy), ("$o", channel), ("$x", place), ("$q", quad)];
    let line = numbers.iter().fold(line.to_owned(), |line, (marker, n)| line.replace(marker, &n.to_string()));
    line.replace("$e", element)
}

/// Replaces each of the markers that repeat lines with a number.
fn with_number(line: &str, number: &str) -> String {
    REPEATING.iter().fold(line.to_owned(), |line, marker| line.replace(marker, number))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unrolled(wgsl: &'static str, unroll: impl Into<Unroll>) -> String {
        Source { name: "test", wgsl, appended: &[] }.unrolled(unroll)
    }

    #[test]
    fn a_quad_of_channels_may_differ_from_place_to_place() {
        let unroll = Unroll { span: 2, ..8.into() };
        let all = "let w0_0 = a[0 + 0u]; let w1_0 = a[1 + 0u]; let w0_1 = a[0 + 1u]; let w1_1 = a[1 + 1u];";
        assert_eq!(unrolled("let w$q_$x = a[$q + $xu];", unroll).trim_end(), all);
    }

    #[test]
    fn an_output_has_a_channel_and_a_place() {
        let unroll = Unroll { span: 2, ..8.into() };
        let outputs = unrolled("y$c = w$q.$e * v$x + $o;", unroll);
        let outputs: Vec<&str> = outputs.trim_end().split("; ").collect();
        assert_eq!(outputs.len(), 16);
        assert_eq!(outputs[..3], ["y0 = w0.x * v0 + 0", "y1 = w0.x * v1 + 0", "y2 = w0.y * v0 + 1"]);
        assert_eq!(outputs[15], "y15 = w1.w * v1 + 7;");
    }

    #[test]
    fn other_markers_count_quads_places_second_outputs_eights_and_fours() {
        let unroll = Unroll { span: 3, second: 2, ..8.into() };
        assert_eq!(unrolled("a$q;", unroll), "a0; a1;\n");
        assert_eq!(unrolled("b$x;", unroll), "b0; b1; b2;\n");
        assert_eq!(unrolled("c$k;", unroll), "c0; c1;\n");
        assert_eq!(unrolled("$8", unroll), "0 1 2 3 4 5 6 7\n");
        assert_eq!(unrolled("$4", unroll), "0 1 2 3\n");
        assert_eq!(unrolled("$4$k", unroll), "00 01 10 11 20 21 30 31\n");
        assert_eq!(unrolled("$n $m $t", unroll), "8u 2u 2u\n");
    }

    #[test]
    fn sections_belong_to_one_kind_of_reading() {
        let wgsl = "a\n#if broadcast\nb$q\n#else\nc\n#endif\nd\n#if broadcast\ne\n#endif";
        assert_eq!(unrolled(wgsl, 8), "a\n\n\n\nc\n\nd\n\n\n\n");
        let broadcast = unrolled(wgsl, Unroll { sharing: Sharing::Broadcast, ..8.into() });
        assert_eq!(broadcast, "a\n\nb0 b1\n\n\n\nd\n\ne\n\n");
        let texels = Unroll { texels: true, ..8.into() };
        assert_eq!(unrolled("#if texels\na\n#else\nb\n#endif", texels), "\na\n\n\n\n");
    }

    #[test]
    fn operands_are_bound_as_uniforms_if_their_length_is_given() {
        let wgsl = "var<$space0> a: array<vec4f$length0>;\nvar<$space1> b: array<vec4f$length1>;";
        let text = "var<storage, read> a: array<vec4f>;\nvar<uniform> b: array<vec4f, 3>;\n";
        assert_eq!(unrolled(wgsl, Unroll { uniforms: [0, 3], ..8.into() }), text);
    }

    #[test]
    fn lines_keep_their_numbers() {
        let text = unrolled("first\nsecond $q\nthird", 16);
        assert_eq!(
            text.lines().collect::<Vec<_>>(),
            ["first", "second 0 second 1 second 2 second 3", "third"]
        );
    }

    #[test]
    fn operands_are_loaded_or_passed_on() {
        let wgsl = "fn f(a: u32$lane) {\nlet w$k = $same(r[at + $k]);";
        let unroll = Unroll { second: 10, ..0.into() };
        let loads = unrolled(wgsl, unroll);
        assert!(loads.starts_with("fn f(a: u32) {\nlet w0 = r[at + 0]; let w1 = r[at + 1]; "), "{loads}");
        let broadcast = unrolled(wgsl, Unroll { sharing: Sharing::Broadcast, ..unroll });
        let (entry, line) = broadcast.split_once('\n').unwrap();
        assert_eq!(entry, "fn f(a: u32, @builtin(subgroup_invocation_id) lane: u32) {");
        assert_eq!(line.matches("subgroupBroadcast").count(), 10);
        // Two loads for ten operands. The second covers the last two, and the remaining lanes load the last
        // one again.
        assert_eq!(line.matches("r[").count(), 2);
        assert!(line.starts_with(
            "let w_held0 = r[at + (0u + min(lane % 8u, 7u))];let w0 = subgroupBroadcast(w_held0, 0u);"
        ));
        let rest = "let w_held8 = r[at + (8u + min(lane % 8u, 1u))];let w8 = subgroupBroadcast(w_held8, 0u);";
        assert!(line.contains(rest), "{line}");
    }

    #[test]
    fn storage_is_named_where_it_is_used() {
        let half = Unroll { storage: Storage::F16, ..0.into() };
        assert_eq!(unrolled("var x: f32;", half), "var x: f32;\n");
        let text = unrolled("var x: StoredQuad;", half);
        assert!(
            text.starts_with("enable f16; var x") && text.contains("alias StoredQuad = vec4<f16>;"),
            "{text}"
        );
    }

    #[test]
    #[should_panic(expected = "test.wgsl: expected $same(array[index]);")]
    fn an_operand_ends_its_line() {
        unrolled("let w$q = $same(r[$q]) * 2.0;", 8);
    }
}
