//! The WGSL files and the table of kernels: every file is in the table, is valid, and follows the rules that
//! the host side and readers rely on. Needs no adapter.

use super::{cloth, fft, operator, optim, train};
use crate::gpu::{Order, Sharing, Source, Storage, Tensor, Unroll};
use naga::valid::{Capabilities, ShaderStages, SubgroupOperationSet, ValidationFlags, Validator};
use naga::{AddressSpace, ImageClass, StorageAccess, TypeInner};
use std::collections::{BTreeSet, HashSet};
use std::path::{Path, PathBuf};

/// Every kernel, with a tile size for which it is unrolled somewhere (0 if it has no tile).
const ALL: &[(&Source, usize)] = &[
    (&cloth::external_force::SOURCE, 0),
    (&cloth::predict::SOURCE, 0),
    (&cloth::gradient::SOURCE, 0),
    (&cloth::sheet_axes::SOURCE, 0),
    (&cloth::curvature::SOURCE, 0),
    (&cloth::cell_count::SOURCE, 0),
    (&cloth::cell_scan::SOURCE, 0),
    (&cloth::cell_fill::SOURCE, 0),
    (&cloth::cell_order::SOURCE, 0),
    (&cloth::repulsion::SOURCE, 0),
    (&cloth::repulsion_curvature::SOURCE, 0),
    (&cloth::contact_find::SOURCE, 0),
    (&cloth::contact_axes::SOURCE, 0),
    (&cloth::contact::SOURCE, 0),
    (&cloth::contact_curvature::SOURCE, 0),
    (&cloth::couple::SOURCE, 0),
    (&cloth::couple_curvature::SOURCE, 0),
    (&cloth::contact_confine::SOURCE, 0),
    (&cloth::contact_report::SOURCE, 0),
    (&cloth::contact_end::SOURCE, 0),
    (&cloth::layer_motion::SOURCE, 0),
    (&cloth::layer_place::SOURCE, 0),
    (&cloth::layer_find::SOURCE, 0),
    (&cloth::layer_list::SOURCE, 0),
    (&cloth::layer_order::SOURCE, 0),
    (&cloth::layer_axes::SOURCE, 0),
    (&cloth::layer_press::SOURCE, 0),
    (&cloth::layer_force::SOURCE, 0),
    (&cloth::layer_curvature::SOURCE, 0),
    (&cloth::layer_part::SOURCE, 0),
    (&cloth::layer_report::SOURCE, 0),
    (&cloth::energy::SOURCE, 0),
    (&cloth::energy_sum::SOURCE, 0),
    (&cloth::integrate::SOURCE, 0),
    (&cloth::vertices::SOURCE, 0),
    (&cloth::embed::SOURCE, 0),
    (&optim::features::SOURCE, 0),
    (&optim::update::SOURCE, 0),
    (&optim::gradient_descent::SOURCE, 0),
    (&optim::adam::SOURCE, 0),
    (&optim::lbfgs::SOURCE, 0),
    (&optim::cosine_order::SOURCE, 0),
    (&optim::rest_modes::SOURCE, 0),
    (&optim::cosine_rows::SOURCE, 0),
    (&optim::cosine_columns::SOURCE, 0),
    (&optim::answer_rows::SOURCE, 0),
    (&optim::sheet_steps::SOURCE, 0),
    (&optim::extrapolate::SOURCE, 0),
    (&optim::subspace_step::SOURCE, 0),
    (&operator::pointwise::SOURCE, 16),
    (&operator::transform_rows::SOURCE, 10),
    (&operator::spectral::SOURCE, 5),
    (&operator::block::SOURCE, 16),
    (&operator::block::LIFTING, 16),
    (&operator::block::LIFTING_OF_FIELDS, 16),
    (&operator::pool_rows::SOURCE, 0),
    (&operator::scalar_head::SOURCE, 0),
    (&operator::project::SOURCE, 0),
    (&operator::activate::SOURCE, 0),
    (&operator::multiply_add::SOURCE, 0),
    (&operator::gelu_adj::SOURCE, 0),
    (&operator::transpose::SOURCE, 0),
    (&operator::spectral_transpose::SOURCE, 0),
    (&operator::pointwise_weight_adj::SOURCE, 0),
    (&operator::spectral_weight_adj::SOURCE, 4),
    (&operator::head_weight_adj::SOURCE, 0),
    (&operator::sum_parts::SOURCE, 0),
    (&operator::pool_adj::SOURCE, 0),
    (&operator::project_adj::SOURCE, 0),
    (&optim::update_adj::SOURCE, 0),
    (&train::draw::SOURCE, 0),
    (&train::advance::SOURCE, 0),
    (&train::store::SOURCE, 0),
    (&train::gradient_size::SOURCE, 0),
    (&train::squares::SOURCE, 0),
    (&train::adamw::SOURCE, 0),
    (&fft::pack_pairs::SOURCE, 0),
    (&fft::unpack_pairs::SOURCE, 0),
    (&fft::split_spectra::SOURCE, 0),
    (&fft::join_spectra::SOURCE, 0),
    (&fft::radix4::SOURCE, 0),
    (&fft::radix_prime::SOURCE, 0),
];

/// Kernels without a parity test of that name, and the test that covers them.
const TESTED_ELSEWHERE: &[(&str, &str)] = &[
    ("energy_sum", "energy"),
    ("contact_find", "contact"),
    ("contact_axes", "contact"),
    ("contact_curvature", "contact"),
    ("couple_curvature", "couple"),
    ("contact_confine", "contact"),
    ("contact_report", "contact"),
    ("contact_end", "contact"),
    ("layer_motion", "layers"),
    ("layer_place", "layers"),
    ("layer_find", "layers"),
    ("layer_list", "layers"),
    ("layer_order", "layers"),
    ("layer_axes", "layers"),
    ("layer_press", "layers"),
    ("layer_force", "layers"),
    ("layer_curvature", "layers"),
    ("layer_part", "layers"),
    ("layer_report", "layers"),
    // Meaningful only together.
    ("cell_count", "cells"),
    ("cell_scan", "cells"),
    ("cell_fill", "cells"),
    ("cell_order", "cells"),
    ("activate", "gelu_adj"),
    ("spectral_transpose", "transpose"),
    ("sum_parts", "pointwise_weight_adj"),
    ("advance", "draw"),
    ("store", "draw"),
    ("squares", "adamw"),
    ("cosine_order", "quasi_newton"),
    ("rest_modes", "quasi_newton"),
    ("cosine_rows", "sheet_steps"),
    ("cosine_columns", "sheet_steps"),
    ("answer_rows", "sheet_steps"),
    // The passes of a transform are meaningful only together.
    ("pack_pairs", "real_fft2"),
    ("unpack_pairs", "real_fft2"),
    ("split_spectra", "real_fft2"),
    ("join_spectra", "real_fft2"),
    ("radix4", "real_fft2"),
    ("radix_prime", "real_fft2"),
];

/// Kernels whose counterpart on the CPU path has another name.
const TWINS: &[(&str, &str)] = &[
    ("external_force", "cloth/wind"),
    ("predict", "cloth/integrate"),
    ("energy_sum", "cloth/energy"),
    ("cell_count", "cloth/cells"),
    ("cell_scan", "cloth/cells"),
    ("cell_fill", "cloth/cells"),
    ("cell_order", "cloth/cells"),
    ("repulsion_curvature", "cloth/repulsion"),
    ("contact_find", "cloth/contacts"),
    ("contact_axes", "cloth/contacts"),
    ("contact", "cloth/contacts"),
    ("contact_curvature", "cloth/contacts"),
    ("couple", "cloth/couples"),
    ("couple_curvature", "cloth/couples"),
    ("contact_confine", "cloth/contacts"),
    ("contact_report", "cloth/contacts"),
    ("contact_end", "cloth/contacts"),
    ("layer_motion", "cloth/layers"),
    ("layer_place", "cloth/layers"),
    ("layer_find", "cloth/layers"),
    ("layer_list", "cloth/layers"),
    ("layer_order", "cloth/layers"),
    ("layer_axes", "cloth/layers"),
    ("layer_press", "cloth/layers"),
    ("layer_force", "cloth/layers"),
    ("layer_curvature", "cloth/layers"),
    ("layer_part", "cloth/layers"),
    ("layer_report", "cloth/layers"),
    ("features", "optim/update"),
    ("gradient_descent", "optim/gd"),
    ("cosine_order", "optim/rest_hessian"),
    ("rest_modes", "optim/rest_hessian"),
    ("cosine_rows", "optim/rest_hessian"),
    ("cosine_columns", "optim/rest_hessian"),
    ("answer_rows", "optim/sheet_hessian"),
    ("sheet_steps", "optim/sheet_hessian"),
    ("subspace_step", "optim/subspace"),
    ("transform_rows", "operator/transform"),
    ("pool_rows", "operator/scalar_head"),
    ("project", "operator/projection"),
    ("activate", "real"),
    ("multiply_add", "matmul"),
    ("gelu_adj", "real"),
    ("transpose", "operator/adjoint"),
    ("spectral_transpose", "operator/adjoint"),
    ("pointwise_weight_adj", "operator/pointwise"),
    ("spectral_weight_adj", "operator/spectral"),
    ("head_weight_adj", "operator/scalar_head"),
    ("sum_parts", "operator/adjoint"),
    ("pool_adj", "operator/scalar_head"),
    ("project_adj", "operator/projection"),
    ("draw", "../train/arrays"),
    ("advance", "../train/arrays"),
    ("store", "../train/arrays"),
    ("gradient_size", "train/loss"),
    ("squares", "train/adamw"),
    ("pack_pairs", "fft"),
    ("unpack_pairs", "fft"),
    ("split_spectra", "fft"),
    ("join_spectra", "fft"),
    ("radix4", "fft"),
    ("radix_prime", "fft"),
];

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Returns the files with this ending as `subfolder/stem`, without the subfolders `common` and `pieces`.
fn stems(folder: &str, ending: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for entry in std::fs::read_dir(root().join(folder)).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().into_string().unwrap();
        for file in std::fs::read_dir(entry.path())
            .into_iter()
            .flatten()
            .filter(|_| !["common", "pieces", "terms"].contains(&&*name))
        {
            let file = file.unwrap().file_name().into_string().unwrap();
            found.extend(file.strip_suffix(ending).map(|stem| format!("{name}/{stem}")));
        }
    }
    found
}

/// Returns the stem with its folder, such as `optim/update`.
fn place(source: &Source) -> String {
    let found = stems("shaders", ".wgsl");
    let place = found.into_iter().find(|p| p.ends_with(&format!("/{}", source.name)));
    place.unwrap_or_else(|| panic!("no file for {}", source.name))
}

fn parsed(source: &Source, unroll: impl Into<Unroll>) -> (String, naga::Module) {
    let text = source.unrolled(unroll);
    let module = naga::front::wgsl::parse_str(&text)
        .unwrap_or_else(|e| panic!("{}.wgsl: {}", source.name, e.emit_to_string(&text)));
    (text, module)
}

/// Returns the tiles and spans that a kernel is unrolled to, including those in the table.
fn tiles(source: &Source, tile: usize) -> Vec<(usize, usize)> {
    let spans: &[usize] = if source.name == "block" { &[1, 2, 4] } else { &[1] };
    let tiles =
        if ["pointwise", "block"].contains(&source.name) { vec![4, 8, 16, 32, 64] } else { vec![tile] };
    tiles.iter().flat_map(|&tile| spans.iter().map(move |&span| (tile, span))).collect()
}

#[test]
fn every_file_is_in_the_table_once() {
    let listed: Vec<_> = ALL.iter().map(|(source, _)| (place(source), source.appended)).collect();
    let unique: BTreeSet<_> = listed.iter().collect();
    assert_eq!(listed.len(), unique.len(), "a kernel is listed twice");
    let files: BTreeSet<String> = listed.into_iter().map(|(place, _)| place).collect();
    assert_eq!(files, stems("shaders", ".wgsl"));
    for (source, _) in ALL {
        let file = std::fs::read_to_string(root().join(format!("shaders/{}.wgsl", place(source)))).unwrap();
        assert_eq!(file, source.wgsl, "{} includes another file", source.name);
    }
}

/// Translates a kernel to the languages of Direct3D and Metal.
fn translate(name: &str, (module, info): (&naga::Module, &naga::valid::ModuleInfo), plain: bool) {
    use naga::back::{hlsl, msl, pipeline_constants::process_overrides};
    // Any value, where the host always gives one.
    let given = module.overrides.iter().filter(|(_, constant)| constant.init.is_none());
    let given = given.map(|(_, constant)| (constant.name.clone().expect("a name"), 1.0)).collect();
    let constants = process_overrides(module, info, None, &given);
    let (module, info) = constants.unwrap_or_else(|e| panic!("{name}: {e}"));
    let (module, info) = (module.as_ref(), info.as_ref());
    // Without extensions, that of the compiler which every Windows has.
    let shader_model = if plain { hlsl::ShaderModel::V5_1 } else { hlsl::ShaderModel::V6_2 };
    let (options, mut text) = (hlsl::Options { shader_model, ..Default::default() }, String::new());
    let written = hlsl::Writer::new(&mut text, &options, &Default::default()).write(module, info, None);
    let names = written.unwrap_or_else(|e| panic!("{name} in HLSL: {e}")).entry_point_names;
    assert!(names.iter().all(Result::is_ok) && text.contains("numthreads"), "{name} in HLSL: {names:?}");
    let options = msl::Options { lang_version: (2, 3), ..Default::default() };
    let (text, written) = msl::write_string(module, info, &options, &Default::default())
        .unwrap_or_else(|e| panic!("{name} in MSL: {e}"));
    let names = written.entry_point_names;
    assert!(names.iter().all(Result::is_ok) && text.contains("kernel void"), "{name} in MSL: {names:?}");
}

#[test]
fn every_kernel_is_valid_wgsl_and_translates_to_hlsl_and_msl() {
    for &(source, tile) in ALL {
        // The first variants have the fewest capabilities: a text that repeats needs no others.
        let mut seen = HashSet::new();
        for (tile, span) in tiles(source, tile) {
            // Nothing beyond core WebGPU, except where operands are broadcast or stored in 16 bits.
            let (broadcast, half) =
                (Capabilities::SUBGROUP | Capabilities::SHADER_INT64, Capabilities::SHADER_FLOAT16);
            let variants = [
                (Sharing::Loads, Storage::F32, [0, 0], Capabilities::empty()),
                (Sharing::Loads, Storage::F16, [0, 0], half),
                (Sharing::Broadcast, Storage::F32, [0, 0], broadcast),
                (Sharing::Broadcast, Storage::F32, [1024, 160], broadcast),
                (Sharing::Broadcast, Storage::F16, [0, 160], broadcast | half),
            ];
            let variants = variants.into_iter().flat_map(|variant| [(variant, false), (variant, true)]);
            for ((sharing, storage, uniforms, capabilities), texels) in variants {
                let order = Order::Natural;
                let unroll = Unroll { tile, span, second: 10, sharing, uniforms, texels, storage, order };
                if !seen.insert(source.unrolled(unroll)) {
                    continue;
                }
                let (text, module) = parsed(source, unroll);
                let mut validator = Validator::new(ValidationFlags::all(), capabilities);
                let info = validator
                    .subgroup_stages(ShaderStages::COMPUTE)
                    .subgroup_operations(SubgroupOperationSet::all())
                    .validate(&module)
                    .unwrap_or_else(|e| panic!("{}.wgsl: {}", source.name, e.emit_to_string(&text)));
                translate(source.name, (&module, &info), capabilities.is_empty());
            }
        }
    }
}

#[test]
fn entry_points_are_named_after_their_file() {
    for &(source, tile) in ALL {
        let (_, module) = parsed(source, tile);
        let names: Vec<&str> = module.entry_points.iter().map(|e| e.name.as_str()).collect();
        assert_eq!(names, [source.name]);
    }
}

#[test]
fn bindings_are_parameters_then_reads_then_writes() {
    for (&(source, tile), texels) in ALL.iter().flat_map(|kernel| [(kernel, false), (kernel, true)]) {
        let (_, module) = parsed(source, Unroll { texels, ..tile.into() });
        let mut bound: Vec<_> = module
            .global_variables
            .iter()
            .filter_map(|(_, v)| v.binding.as_ref().map(|b| (b.group, b.binding, v)))
            .collect();
        bound.sort_by_key(|b| (b.0, b.1));
        let name = source.name;
        assert!(bound.iter().all(|b| b.0 == 0), "{name} binds outside group 0");
        let numbers: Vec<u32> = bound.iter().map(|b| b.1).collect();
        assert_eq!(numbers, (0..bound.len() as u32).collect::<Vec<_>>(), "{name} leaves a binding out");
        assert_eq!(bound[0].2.space, AddressSpace::Uniform, "{name}: binding 0");
        assert_eq!(bound[0].2.name.as_deref(), Some("params"), "{name}: binding 0");
        let writes: Vec<bool> = bound[1..]
            .iter()
            .map(|b| match b.2.space {
                AddressSpace::Storage { access } => access.contains(StorageAccess::STORE),
                AddressSpace::Handle => match module.types[b.2.ty].inner {
                    TypeInner::Image { class: ImageClass::Storage { access, .. }, .. } => {
                        access.contains(StorageAccess::STORE)
                    }
                    _ => false,
                },
                other => panic!("{name} binds {other:?}"),
            })
            .collect();
        assert!(writes.len() <= 8, "{name} binds {} storage buffers", writes.len());
        assert!(writes.is_sorted() && writes.last() == Some(&true), "{name}: reads come before writes");
    }
}

/// The size that the host's parameters must have.
#[test]
fn the_size_of_parameters_is_that_of_the_uniform() {
    for &(source, tile) in ALL {
        let (_, module) = parsed(source, tile);
        let uniform = module.global_variables.iter().find(|(_, v)| v.space == AddressSpace::Uniform);
        let (_, uniform) = uniform.expect("every kernel has parameters");
        let size = module.types[uniform.ty].inner.size(module.to_ctx());
        assert_eq!(source.bindings(&module)[0].size, size, "{}", source.name);
    }
}

#[test]
fn headers_state_purpose_threads_and_adjoint() {
    for (source, _) in ALL {
        let header: Vec<&str> = source.wgsl.lines().take_while(|l| l.starts_with("//")).collect();
        let has = |word: &str| header.iter().any(|l| l.contains(word));
        for word in ["// Adjoint: ", "One ", "Workgroups: "] {
            assert!(has(word), "{}.wgsl: its header has no '{word}'", source.name);
        }
        // The first line is the purpose, followed by a blank one.
        assert!(header.len() > 3 && header.contains(&"//"), "{}.wgsl: {header:#?}", source.name);
    }
}

/// Reads the files of a folder of `shaders`.
fn texts(folder: &str) -> Vec<String> {
    let files = std::fs::read_dir(root().join("shaders").join(folder)).unwrap();
    files.map(|file| std::fs::read_to_string(file.unwrap().path()).unwrap()).collect()
}

#[test]
fn shared_texts_hold_functions_only() {
    let (common, pieces) = ([texts("common"), texts("terms")].concat(), texts("pieces"));
    let used = |text: &String| ALL.iter().any(|(source, _)| source.appended.contains(&&**text));
    assert!(common.iter().chain(&pieces).all(used), "a text that no kernel calls");
    for (source, tile) in ALL {
        for &text in source.appended.iter().filter(|text| !pieces.iter().any(|piece| piece == *text)) {
            assert!(common.iter().any(|known| known == text), "{}: {text}", source.name);
            let module = naga::front::wgsl::parse_str(text).unwrap();
            assert!(module.global_variables.is_empty() && module.entry_points.is_empty(), "{}", source.name);
        }
        // The kernel's functions and the shared ones have different names: the whole parses.
        parsed(source, *tile);
    }
}

#[test]
fn every_kernel_has_its_host_side_twin_and_parity_test() {
    let elsewhere =
        |list: &[(&str, &'static str)], stem: &str| list.iter().find(|l| l.0 == stem).map(|l| l.1);
    let exists = |path: String| assert!(Path::new(&root()).join(&path).is_file(), "{path} does not exist");
    for (source, _) in ALL {
        let place = place(source);
        exists(format!("src/kernels/{place}.rs"));
        exists(format!("src/cpu/{}.rs", elsewhere(TWINS, source.name).unwrap_or(&place)));
        let test = elsewhere(TESTED_ELSEWHERE, source.name).unwrap_or(source.name);
        exists(format!("tests/gpu/parity/{test}.rs"));
        let modules = std::fs::read_to_string(root().join("tests/gpu/parity/mod.rs")).unwrap();
        assert!(modules.contains(&format!("mod {test};")), "parity/{test}.rs is not compiled");
    }
}

/// The one array that is not bounded by a tensor's size. The host refuses longer histories.
#[test]
fn the_longest_history_is_the_same_on_both_sides() {
    let longest = crate::settings::MAX_HISTORY;
    let source = optim::lbfgs::SOURCE.wgsl;
    assert!(source.contains(&format!("const MAX_HISTORY: u32 = {longest}u;")), "{longest}");
}

/// The constants of contacts, which parity tests would not all tell apart.
#[test]
fn contacts_have_the_same_constants_on_both_sides() {
    use crate::cloth::SelfContact;
    use crate::cloth::terms::Contact;
    let (motion, term) = (cloth::layer_motion::SOURCE.wgsl, super::terms::CONTACT);
    let is_there = |text: &str, name: &str, value: f64| {
        let line = text.lines().find_map(|line| line.strip_prefix(&format!("const {name}: ")));
        let number = line.and_then(|line| line.split_once("= ")).map(|(_, number)| number);
        let number = number.map(|number| number.trim_end_matches([';', 'u']).parse::<f64>());
        let Some(Ok(number)) = number else { panic!("{name}: {line:?}") };
        assert_eq!(number as f32, value as f32, "{name}");
    };
    is_there(term, "STICKING", Contact::STICKING);
    is_there(term, "LEAST_GAP", Contact::LEAST_GAP);
    is_there(term, "STIFFEST", Contact::STIFFEST);
    is_there(term, "LEAST_ADVANCE", Contact::LEAST_ADVANCE);
    is_there(term, "MOST_ADVANCES", Contact::STEPS as f64);
    is_there(motion, "MARGIN", SelfContact::MARGIN);
    is_there(motion, "BUDGET", SelfContact::BUDGET);
    is_there(motion, "NEAR", SelfContact::NEAR);
}

#[test]
fn rows_of_texels_are_as_long_on_both_sides() {
    let place = std::fs::read_to_string(root().join("shaders/common/texel.wgsl")).unwrap();
    let wide = Tensor::TEXELS;
    assert!(place.contains(&format!("vec2u(at % {wide}u, at / {wide}u)")), "{wide}");
}
