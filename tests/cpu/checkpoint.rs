//! Checkpoint files: round trips, other number types, and every kind of damage.

use crate::golden::{path, weights};
use fnopt::network::{Checkpoint, Config, Weights};
use proptest::prelude::*;
use safetensors::tensor::{Dtype, TensorView};
use std::collections::HashMap;

/// A tensor as name, type, shape and bytes.
type Raw = (String, Dtype, Vec<usize>, Vec<u8>);

fn tiny() -> Weights {
    // The smallest possible network, so that many damaged files can be tested quickly.
    let config =
        Config { fields: 3, lifting: 2, channels: 3, projection: 2, layers: 2, modes_h: 2, modes_w: 1 };
    let mut next = 0.0;
    let mut values = |n: usize| {
        (0..n)
            .map(|_| {
                next += 0.25;
                next
            })
            .collect::<Vec<f32>>()
    };
    let mut dense = |o: usize, i: usize| fnopt::network::Dense { weight: values(o * i), bias: values(o) };
    let (lifting, projection) = ([dense(2, 5), dense(3, 2)], [dense(2, 3), dense(1, 2)]);
    let scalar = dense(1, 3);
    let mut block = || fnopt::network::Block { spectral: values(36), bias: values(3), skip: values(9) };
    Weights { config, lifting, blocks: vec![block(), block()], projection, scalar }
}

fn raw(weights: &Weights) -> Vec<Raw> {
    let tensors = weights.named_tensors().into_iter();
    tensors
        .map(|(name, shape, v)| (name, Dtype::F32, shape, v.iter().flat_map(|v| v.to_le_bytes()).collect()))
        .collect()
}

fn file(tensors: &[Raw], config: Option<&str>) -> Vec<u8> {
    let views = tensors
        .iter()
        .map(|(name, dtype, shape, bytes)| (name, TensorView::new(*dtype, shape.clone(), bytes).unwrap()));
    let metadata = config.map(|json| HashMap::from([("config".to_owned(), json.to_owned())]));
    safetensors::serialize(views, metadata).unwrap()
}

fn error(bytes: &[u8]) -> String {
    Weights::from_bytes(bytes, "test.safetensors").unwrap_err().to_string()
}

#[test]
fn the_authors_weights_have_the_published_size() {
    let weights = weights();
    assert_eq!(weights.config, Config::default());
    assert_eq!(weights.parameter_count(), 1_349_634);
}

#[test]
fn saving_and_loading_keeps_every_bit() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path().join("weights.safetensors");
    for weights in [tiny(), weights()] {
        weights.save(&at).unwrap();
        assert_eq!(Weights::load(&at).unwrap(), weights);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
    }
    let checkpoint = Checkpoint::open(&at).unwrap();
    assert!(checkpoint.describe().metadata.contains_key("config"));
}

#[test]
fn unwritable_and_missing_files_are_reported() {
    let missing = Weights::load(path("nowhere")).unwrap_err().to_string();
    assert!(missing.contains("nowhere.safetensors: cannot read"), "{missing}");
    let unwritable = tiny().save(path("no/such/folder")).unwrap_err().to_string();
    assert!(unwritable.contains("cannot write"), "{unwritable}");
}

#[test]
fn names_without_prefix_and_other_number_types() {
    let weights = tiny();
    let convert = |change: &dyn Fn(&mut Raw)| {
        let mut tensors = raw(&weights);
        tensors.iter_mut().for_each(change);
        Weights::from_bytes(&file(&tensors, None), "test").unwrap()
    };
    fn numbers(bytes: &[u8]) -> impl Iterator<Item = f32> {
        bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap()))
    }
    assert_eq!(convert(&|t| t.0 = t.0.trim_start_matches("nn.").to_owned()), weights);
    // Half precision holds all values of the small network exactly, and bfloat16 to 1/256.
    assert_eq!(
        convert(&|t| (t.1, t.3) =
            (Dtype::F16, numbers(&t.3).flat_map(|v| half::f16::from_f32(v).to_le_bytes()).collect())),
        weights
    );
    assert_eq!(
        convert(
            &|t| (t.1, t.3) = (Dtype::F64, numbers(&t.3).flat_map(|v| f64::from(v).to_le_bytes()).collect())
        ),
        weights
    );
    let brain = convert(&|t| {
        (t.1, t.3) =
            (Dtype::BF16, numbers(&t.3).flat_map(|v| half::bf16::from_f32(v).to_le_bytes()).collect())
    });
    for (found, expected) in brain.blocks[1].skip.iter().zip(&weights.blocks[1].skip) {
        assert!((found - expected).abs() <= expected / 256.0);
    }
    let complex = |t: &mut Raw| {
        if t.2.len() == 5 {
            t.1 = Dtype::C64;
            t.2.pop();
        }
    };
    assert_eq!(convert(&complex), weights);
}

#[test]
fn soft_gates_become_diagonal_skips() {
    let weights = tiny();
    let mut tensors = raw(&weights);
    for t in &mut tensors {
        if t.0.contains("fno_skips") {
            t.0 = t.0.replace(".conv.weight", ".weight");
            (t.2, t.3) =
                (vec![1, 3, 1, 1], [1.0f32, 2.0, 3.0].iter().flat_map(|v| v.to_le_bytes()).collect());
        }
    }
    let gated = file(&tensors, None);
    let skip = |bytes: &[u8]| Checkpoint::from_bytes(bytes, "test").unwrap().describe().skip();
    assert_eq!((skip(&gated), skip(&file(&raw(&weights), None))), ("soft-gating", "linear"));
    let gated = Weights::from_bytes(&gated, "test").unwrap();
    assert_eq!(gated.blocks[1].skip, [1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 3.0]);
}

#[test]
fn damage_is_reported_by_name() {
    let good = raw(&tiny());
    let with = |change: &dyn Fn(&mut Vec<Raw>)| {
        let mut tensors = good.clone();
        change(&mut tensors);
        error(&file(&tensors, None))
    };
    let at = |name: &str| good.iter().position(|t| t.0 == name).unwrap();
    let skip = at("nn.fno_blocks.fno_skips.1.conv.weight");
    assert_eq!(
        with(&|t| {
            t.remove(skip);
        }),
        "test.safetensors: tensor 'fno_blocks.fno_skips.1.conv.weight': expected a tensor with this name, found none among 14 tensors"
    );
    assert_eq!(
        with(&|t| t.push(("nn.lifting.fcs.0.weigth".into(), Dtype::F32, vec![1], vec![0; 4]))),
        "test.safetensors: unknown tensor 'nn.lifting.fcs.0.weigth' (did you mean nn.lifting.fcs.0.weight, nn.lifting.fcs.1.weight?)"
    );
    assert_eq!(
        with(&|t| t[skip].2 = vec![9, 1]),
        "test.safetensors: tensor 'nn.fno_blocks.fno_skips.1.conv.weight': expected shape [3, 3], found [9, 1]"
    );
    assert_eq!(
        with(&|t| t[skip].3[4..8].copy_from_slice(&f32::NAN.to_le_bytes())),
        "test.safetensors: tensor 'nn.fno_blocks.fno_skips.1.conv.weight': expected finite numbers, found NaN at element 1"
    );
    assert_eq!(
        with(&|t| t[skip].1 = Dtype::I32),
        "test.safetensors: tensor 'nn.fno_blocks.fno_skips.1.conv.weight': expected dtype F64, F32, F16, BF16 or C64, found I32"
    );
    let bytes = file(&good, None);
    let truncated = error(&bytes[..bytes.len() - 3]);
    assert!(
        truncated.starts_with("test.safetensors: header: expected a complete safetensors file"),
        "{truncated}"
    );
}

#[test]
fn a_configuration_in_the_metadata_is_binding() {
    let tensors = raw(&tiny());
    let json = serde_json::to_string(&tiny().config).unwrap();
    assert_eq!(Weights::from_bytes(&file(&tensors, Some(&json)), "test").unwrap(), tiny());
    let other = json.replace("\"lifting\":2", "\"lifting\":4");
    assert!(
        error(&file(&tensors, Some(&other))).contains("'nn.lifting.fcs.0.weight': expected shape [4, 5]")
    );
    for bad in ["{}", "[", &json.replace("\"layers\":2", "\"layers\":999999999"), &json.replace(":3", ":0")] {
        assert!(error(&file(&tensors, Some(bad))).contains("metadata 'config'"), "{bad}");
    }
}

/// The update rule has three fields, so a network with another number of fields is refused.
#[test]
fn networks_of_other_fields_are_refused() {
    let config = Config { fields: 4, ..tiny().config };
    let weights = Weights::zeros(config);
    let json = serde_json::to_string(&config).unwrap();
    let expected = "expected 3 fields: gradient, last gradient and last step, found 4";
    for (json, field) in [(Some(&json[..]), "metadata 'config'"), (None, "tensor shapes")] {
        assert_eq!(error(&file(&raw(&weights), json)), format!("test.safetensors: {field}: {expected}"));
    }
}

#[test]
fn description_lists_each_tensor() {
    let description = Checkpoint::open(&path("network_weights")).unwrap().describe();
    assert_eq!((description.tensors.len(), description.parameter_count()), (19, 1_349_634));
    let text = description.to_string();
    assert!(
        text.contains("nn.fno_blocks.convs.weight.0.tensor") && text.contains("[64, 64, 8, 5, 2]"),
        "{text}"
    );
    assert!(description.tensors.iter().all(|t| t.norm > 0.0 && t.min <= t.max && t.non_finite == 0));
}

#[test]
fn a_description_counts_what_is_not_finite_and_ranges_over_the_rest() {
    let of = |values: [f32; 3]| {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let tensors = [("x".to_owned(), Dtype::F32, vec![3], bytes)];
        let description = Checkpoint::from_bytes(&file(&tensors, None), "test").unwrap().describe();
        let x = &description.tensors[0];
        (x.min, x.max, x.non_finite)
    };
    assert_eq!(of([f32::INFINITY, -2.0, 3.0]), (-2.0, 3.0, 1));
    let (min, max, count) = of([f32::NAN; 3]);
    assert!(min.is_nan() && max.is_nan() && count == 3);
}

proptest! {
    #[test]
    fn damaged_bytes_never_panic(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8), cut in any::<prop::sample::Index>(), whole in any::<bool>()) {
        let mut bytes = tiny().to_bytes();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if !whole {
            bytes.truncate(cut.index(bytes.len() + 1));
        }
        if let Ok(weights) = Weights::from_bytes(&bytes, "damaged") {
            prop_assert!(weights.parameter_count() > 0);
        }
    }

    #[test]
    fn damaged_headers_never_panic(at in 8usize..1500, text in "[\\[\\]{}\",:0-9a-zF_.]{1,6}") {
        let mut bytes = tiny().to_bytes();
        bytes.splice(at..at + text.len(), text.bytes());
        let _ = Weights::from_bytes(&bytes, "damaged");
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        prop_assert!(Weights::from_bytes(&bytes, "noise").is_err());
    }
}

#[test]
fn weights_survive_the_way_through_one_flat_vector() {
    let tiny = tiny();
    assert_eq!(Weights::from_flat(tiny.config, &tiny.flat()), tiny);
    // The paper's network has this many parameters.
    assert_eq!(Weights::zeros(Config::default()).flat().len(), 1_349_634);
}
