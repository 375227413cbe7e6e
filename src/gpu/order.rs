//! The order in which a kernel's invocations are numbered.

/// How invocations and workgroups are numbered.
///
/// The device decides in which order they run, and no result may depend on it. Software drivers run them one
/// by one in the order of their numbers, so a missing barrier goes unnoticed if the invocation to be waited
/// for has the lower number. With [`Reversed`](Order::Reversed) it has the higher one. For tests.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Order {
    /// The device's numbering.
    #[default]
    Natural,
    /// The reverse: the last is 0, and the first is last.
    Reversed,
}

impl Order {
    /// Returns a kernel's text with the invocations of its entry point `name` numbered in this order. Line
    /// numbers do not change.
    pub(super) fn apply(self, text: String, name: &str) -> String {
        match self {
            Self::Natural => text,
            Self::Reversed => reversed(&text, name),
        }
    }
}

/// Renames the entry point's builtins, and begins its body with variables of the old names that count down.
fn reversed(text: &str, name: &str) -> String {
    let entry = format!("fn {name}(");
    let (before, rest) = text.split_once(&entry).expect("the entry point has the name of its file");
    let (parameters, body) = rest.split_once(") {").expect("a body follows the parameters");
    let (_, size) = before.rsplit_once("@workgroup_size(").expect("an entry point has a workgroup");
    let (size, _) = size.split_once(')').expect("the size is in parentheses");
    let size: Vec<&str> = size.split(',').map(str::trim).chain(["1", "1"]).take(3).collect();
    let size = format!("vec3u({})", size.join(", "));

    let (mut builtins, mut groups, mut lets) = (Vec::new(), None, Vec::new());
    for parameter in parameters.split("@builtin(").skip(1) {
        let (builtin, variable) = parameter.split_once(") ").expect("a variable follows its builtin");
        let (variable, ty) = variable.split_once(": ").expect("a type follows the variable");
        let ty = ty.trim().trim_end_matches(',');
        let last = match builtin {
            "local_invocation_index" => format!("{size}.x * {size}.y * {size}.z - 1u"),
            "local_invocation_id" => format!("{size} - 1u"),
            "workgroup_id" => "number_of_groups - 1u".into(),
            "global_invocation_id" => format!("number_of_groups * {size} - 1u"),
            _ => {
                if builtin == "num_workgroups" {
                    groups = Some(variable);
                }
                builtins.push(format!("@builtin({builtin}) {variable}: {ty}"));
                continue;
            }
        };
        builtins.push(format!("@builtin({builtin}) {variable}_given: {ty}"));
        lets.push(format!("let {variable} = {last} - {variable}_given;"));
    }
    if groups.is_none() {
        builtins.push("@builtin(num_workgroups) number_of_groups: vec3u".into());
    }
    let lets = lets.join(" ").replace("number_of_groups", groups.unwrap_or("number_of_groups"));
    // The line breaks between the parameters are kept, so that the lines of the body keep their numbers.
    let lines = "\n".repeat(parameters.matches('\n').count());
    format!("{before}{entry}{}{lines}) {{ {lets}{body}", builtins.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_count_down_and_lines_stay() {
        let text = "@compute @workgroup_size(8, LANES)\nfn f(\n    @builtin(global_invocation_id) id: vec3u,\n    \
                    @builtin(local_invocation_index) lane: u32,\n) {\n    out[lane] = id.x;\n}\n";
        assert_eq!(Order::Natural.apply(text.into(), "f"), text);
        let size = "vec3u(8, LANES, 1)";
        assert_eq!(
            Order::Reversed.apply(text.into(), "f"),
            format!(
                "@compute @workgroup_size(8, LANES)\nfn f(@builtin(global_invocation_id) id_given: vec3u, \
                 @builtin(local_invocation_index) lane_given: u32, @builtin(num_workgroups) number_of_groups: vec3u\n\n\n) {{ \
                 let id = number_of_groups * {size} - 1u - id_given; \
                 let lane = {size}.x * {size}.y * {size}.z - 1u - lane_given;\n    out[lane] = id.x;\n}}\n"
            )
        );
    }

    #[test]
    fn the_number_of_workgroups_is_taken_once() {
        let text = "@compute @workgroup_size(64) fn g(@builtin(workgroup_id) group: vec3u, \
                    @builtin(num_workgroups) groups: vec3u) { }";
        assert_eq!(
            Order::Reversed.apply(text.into(), "g"),
            "@compute @workgroup_size(64) fn g(@builtin(workgroup_id) group_given: vec3u, \
             @builtin(num_workgroups) groups: vec3u) { let group = groups - 1u - group_given; }"
        );
    }
}
