//! The order in which a kernel's invocations are numbered.

use super::Sharing;

/// How invocations and workgroups are numbered. For tests.
///
/// The device decides in which order they run, and no result may depend on it. Software drivers run them in
/// the order of their numbers, a vector of eight together and one vector after another, so a missing barrier
/// goes unnoticed if the invocation to be waited for is in the same vector or in one before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Order {
    /// The device's numbering.
    #[default]
    Natural,
    /// The reverse: the last is 0, and the first is last.
    Reversed,
    /// Each invocation of a vector is an eighth of the workgroup away from the next, so that none shares its
    /// operands with them ([`Sharing::Loads`]).
    Scattered,
}

impl Order {
    /// Returns a kernel's text with the invocations of its entry point `name` numbered in this order. Line
    /// numbers do not change.
    pub(super) fn apply(self, text: String, name: &str) -> String {
        match self {
            Self::Natural => text,
            Self::Reversed => {
                renumbered(&text, name, "LAST - given_index", "given_groups - 1u - given_group")
            }
            Self::Scattered => renumbered(
                &text,
                name,
                "given_index % 8u * (LAST / 8u + 1u) + given_index / 8u",
                "given_group",
            ),
        }
    }

    /// Returns how kernels in this order read operands for which `wanted` is the fastest way.
    pub(super) fn sharing(self, wanted: Sharing) -> Sharing {
        if self == Self::Scattered { Sharing::Loads } else { wanted }
    }
}

/// Replaces the entry point's builtins, and begins its body with variables of the old names: those of the
/// invocation with this `index`, in which LAST is that of its workgroup's last, and of this `group`.
fn renumbered(text: &str, name: &str, index: &str, group: &str) -> String {
    let entry = format!("fn {name}(");
    let (before, rest) = text.split_once(&entry).expect("the entry point has the name of its file");
    let (parameters, body) = rest.split_once(") {").expect("a body follows the parameters");
    let (_, size) = before.rsplit_once("@workgroup_size(").expect("an entry point has a workgroup");
    let (size, _) = size.split_once(')').expect("the size is in parentheses");
    let size: Vec<&str> = size.split(',').map(str::trim).chain(["1", "1"]).take(3).collect();
    let [x, y, z] = size[..] else { unreachable!("a size has three numbers") };
    let index = index.replace("LAST", &format!("(u32({x}) * u32({y}) * u32({z}) - 1u)"));

    let mut given = String::from(
        "@builtin(local_invocation_index) given_index: u32, @builtin(workgroup_id) given_group: vec3u, \
         @builtin(num_workgroups) given_groups: vec3u",
    );
    let mut lets = format!("let own_index = {index}; let own_group = {group};");
    for parameter in parameters.split("@builtin(").skip(1) {
        let (builtin, variable) = parameter.split_once(") ").expect("a variable follows its builtin");
        let variable = variable.trim().trim_end_matches(',');
        let (name, _) = variable.split_once(": ").expect("a type follows the variable");
        let own = match builtin {
            "local_invocation_index" => "own_index".into(),
            "workgroup_id" => "own_group".into(),
            "num_workgroups" => "given_groups".into(),
            "global_invocation_id" => {
                let local = format!("vec3u(own_index % {x}, own_index / {x} % {y}, own_index / {x} / {y})");
                format!("own_group * vec3u({x}, {y}, {z}) + {local}")
            }
            _ => {
                given += &format!(", @builtin({builtin}) {variable}");
                continue;
            }
        };
        lets += &format!(" let {name} = {own};");
    }
    // The line breaks between the parameters are kept, so that the lines of the body keep their numbers.
    let lines = "\n".repeat(parameters.matches('\n').count());
    format!("{before}{entry}{given}{lines}) {{ {lets}{body}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const GIVEN: &str = "@builtin(local_invocation_index) given_index: u32, \
        @builtin(workgroup_id) given_group: vec3u, @builtin(num_workgroups) given_groups: vec3u";

    #[test]
    fn numbers_count_down_and_lines_stay() {
        let text = "@compute @workgroup_size(8, LANES)\nfn f(\n    @builtin(global_invocation_id) id: vec3u,\n    \
                    @builtin(local_invocation_index) lane: u32,\n) {\n    out[lane] = id.x;\n}\n";
        assert_eq!(Order::Natural.apply(text.into(), "f"), text);
        assert_eq!(
            Order::Reversed.apply(text.into(), "f"),
            format!(
                "@compute @workgroup_size(8, LANES)\nfn f({GIVEN}\n\n\n) {{ \
                 let own_index = (u32(8) * u32(LANES) * u32(1) - 1u) - given_index; \
                 let own_group = given_groups - 1u - given_group; \
                 let id = own_group * vec3u(8, LANES, 1) + \
                 vec3u(own_index % 8, own_index / 8 % LANES, own_index / 8 / LANES); \
                 let lane = own_index;\n    out[lane] = id.x;\n}}\n"
            )
        );
    }

    #[test]
    fn other_builtins_stay_as_they_are() {
        let text = "@compute @workgroup_size(64) fn g(@builtin(workgroup_id) group: vec3u, \
                    @builtin(subgroup_invocation_id) lane: u32) { }";
        assert_eq!(
            Order::Scattered.apply(text.into(), "g"),
            format!(
                "@compute @workgroup_size(64) fn g({GIVEN}, @builtin(subgroup_invocation_id) lane: u32) {{ \
                 let own_index = given_index % 8u * ((u32(64) * u32(1) * u32(1) - 1u) / 8u + 1u) + given_index / 8u; \
                 let own_group = given_group; let group = own_group; }}"
            )
        );
    }
}
