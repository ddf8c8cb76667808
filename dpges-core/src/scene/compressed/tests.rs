use std::path::Path;

use super::planes::largest;
use super::*;
use crate::scene::EnvironmentData;
use crate::scene::lobes::{ABSENT_LOBE, is_absent};
use crate::scene::schema::RateGroup;
use crate::testing::random::Random;
use crate::testing::scenes::numbered;

fn noisy(model: &str, counts: [usize; 2]) -> SceneData {
    let mut random = Random::new(7);
    numbered(model.parse().unwrap(), counts, |_, _| random.between(-3.0, 3.0) as f32)
}

fn compress(scene: &SceneData, quality: &Quality) -> Vec<u8> {
    scene.to_compressed(quality, Path::new("out")).unwrap()
}

fn parse(bytes: &[u8]) -> Result<SceneData> {
    SceneData::from_bytes(bytes, "some.file")
}

/// The reason why `bytes` are no scene.
fn refusal(bytes: &[u8]) -> String {
    match parse(bytes) {
        Err(Error::SceneFile { path, reason }) if path == Path::new("some.file") => reason,
        other => panic!("expected an error of the file, found {other:?}"),
    }
}

/// `scene` in the order of its compressed file.
fn ordered(scene: &SceneData) -> SceneData {
    SceneData {
        surfels: scene.surfels.select(&along_morton_curve(&scene.surfels.positions)),
        gaussians: scene.gaussians.select(&along_morton_curve(&scene.gaussians.positions)),
        ..scene.clone()
    }
}

/// `found` are the numbers of one group, `expected` up to half a step of their range.
fn check_group(name: &str, expected: &[f32], found: &[f32], bits: u8) {
    let bound = |pick: fn(f64, f64) -> f64| expected.iter().copied().map(f64::from).reduce(pick).unwrap_or(0.0);
    let half_step = 0.5 * (bound(f64::max) - bound(f64::min)) / f64::from(largest(bits));
    assert_eq!(expected.len(), found.len(), "{name}");
    for (&expected, &found) in expected.iter().zip(found) {
        let rounding = f64::from(expected.abs().max(found.abs())) * f64::from(f32::EPSILON);
        let error = (f64::from(expected) - f64::from(found)).abs();
        assert!(error <= half_step * (1.0 + 1e-9) + rounding, "{name}: {expected} became {found} at {bits} bits");
    }
}

/// All columns of `found` are those of `expected` up to half a step, if they have no more rows than one block.
fn check_columns<C: Columns<Value = Vec<f32>>>(expected: &C, found: &C, quality: &Quality) {
    assert_eq!(expected.model(), found.model());
    let model = expected.model();
    for ((attribute, expected), found) in expected.iter().zip(found.list()) {
        let (name, bits, width) = (attribute.name, quality.bits(attribute.rate), attribute.width.under(model));
        match Kept::of(attribute, model) {
            Kept::Rotations => rotation::check_within_half_a_step(expected, found, bits),
            Kept::Lobes(lobes) => {
                let count = expected.len() / width.max(1);
                let [(expected_counts, expected), (counts, found)] =
                    [expected, found].map(|values| pack(values, count, lobes));
                assert_eq!(counts, expected_counts, "{name}");
                check_groups(name, &LOBE_GROUPS, &expected, &found, bits);
            }
            Kept::Numbers(groups) => check_groups(name, &groups, expected, found, bits),
        }
    }
}

pub(super) fn check_groups(name: &str, groups: &[usize], expected: &[f32], found: &[f32], bits: u8) {
    let mut first = 0;
    for &len in groups {
        let [expected, found] = [expected, found].map(|values| -> Vec<f32> {
            let rows = values.chunks_exact(groups.iter().sum());
            rows.flat_map(|row| &row[first..first + len]).copied().collect()
        });
        check_group(name, &expected, &found, bits);
        first += len;
    }
}

fn check_round_trip(scene: &SceneData, quality: &Quality) {
    let found = parse(&compress(scene, quality)).unwrap();
    let expected = ordered(scene);
    assert_eq!((&found.info, &found.environment), (&expected.info, &expected.environment));
    check_columns(&expected.surfels, &found.surfels, quality);
    check_columns(&expected.gaussians, &found.gaussians, quality);
}

#[test]
fn every_attribute_comes_back_within_half_a_step() {
    let mut qualities = Quality::LEVELS.map(|(_, quality)| quality).to_vec();
    qualities.push(Quality::from_list([Quality::MIN_BITS; 7]));
    qualities.push(Quality::from_list([Quality::MAX_BITS; 7]));
    qualities.push(Quality::from_list([17, 3, 5, 9, 8, 16, 7]));
    for model in ["sb0", "sb1", "sb2", "sh0", "sh1", "sh3", "sh3+opacity"] {
        for counts in [[0, 0], [1, 0], [0, 1], [1, 1], [40, 70]] {
            for quality in &qualities {
                check_round_trip(&noisy(model, counts), quality);
            }
        }
    }
    check_round_trip(&noisy("sb2", [1000, 2000]), &Quality::MEDIUM);
}

#[test]
fn every_block_has_its_own_range() {
    // beyond the first block, positions and opacities are small
    let mut random = Random::new(3);
    let scene = numbered(ColourModel::default(), [0, 5000], |attribute, at| match attribute.rate {
        RateGroup::Positions => at as f32 / 3.0,
        RateGroup::Opacities if at < 2048 => random.between(-1000.0, 1000.0) as f32,
        _ => random.between(-1.0, 1.0) as f32,
    });
    let found = parse(&compress(&scene, &Quality::MEDIUM)).unwrap();
    assert_eq!(found.gaussians.len(), 5000);
    let expected = ordered(&scene);
    assert_eq!(expected, scene, "the diagonal is in order already");
    let errors: Vec<f32> =
        expected.gaussians.opacities.iter().zip(&found.gaussians.opacities).map(|(a, b)| (a - b).abs()).collect();
    assert!(errors[2048..].iter().all(|&error| error <= 1.01 / 127.0));
    assert!(errors[..2048].iter().any(|&error| error > 1.0));
}

#[test]
fn environments_are_exact_and_absent_lobes_take_no_room() {
    let mut scene = noisy("sb2", [300, 400]);
    for degree in 0..=EnvironmentData::MAX_DEGREE {
        let mut environment = EnvironmentData::neutral(degree);
        environment.coefficients.iter_mut().enumerate().for_each(|(i, c)| *c = (i as f32 * 0.7).cos());
        scene.environment = Some(environment);
        check_round_trip(&scene, &Quality::LOW);
    }
    let all = compress(&scene, &Quality::MEDIUM).len();
    let details = [&mut scene.surfels.colour.detail, &mut scene.gaussians.colour.detail];
    for (i, lobe) in details.into_iter().flat_map(|detail| detail.as_chunks_mut::<6>().0).enumerate() {
        if i % 4 != 0 {
            *lobe = ABSENT_LOBE;
        }
    }
    check_round_trip(&scene, &Quality::MEDIUM);
    let few = compress(&scene, &Quality::MEDIUM);
    assert!(few.len() + 3000 < all, "{} of {all} bytes", few.len());
    let absent = |detail: &[f32]| detail.as_chunks::<6>().0.iter().filter(|lobe| is_absent(&lobe[..])).count();
    let found = parse(&few).unwrap();
    assert_eq!([absent(&found.surfels.colour.detail), absent(&found.gaussians.colour.detail)], [450, 600]);
}

#[test]
fn a_file_is_loaded_like_any_other_and_is_smaller() {
    let folder = tempfile::tempdir().unwrap();
    let (plain, compressed) = (folder.path().join("plain.safetensors"), folder.path().join("small.safetensors"));
    let scene = noisy("sb2", [2000, 3000]);
    scene.save(&plain).unwrap();
    scene.save_compressed(&compressed, &Quality::MEDIUM).unwrap();
    let len = |path: &Path| std::fs::metadata(path).unwrap().len();
    assert!(3 * len(&compressed) < len(&plain), "even of noise: {} of {}", len(&compressed), len(&plain));
    assert_eq!(SceneData::load(&compressed).unwrap(), parse(&compress(&scene, &Quality::MEDIUM)).unwrap());
    let levels = Quality::LEVELS.map(|(_, quality)| compress(&scene, &quality).len());
    assert!(levels.is_sorted_by(|better, worse| better > worse), "{levels:?}");
}

#[test]
fn a_scene_that_is_wrong_is_not_compressed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.safetensors");
    let mut bad = noisy("sb2", [3, 5]);
    bad.gaussians.positions[7] = f32::NAN;
    let error = bad.save_compressed(&path, &Quality::LOW).unwrap_err();
    assert!(matches!(error, Error::NonFinite { tensor, row: 2 } if tensor == "gaussians.positions"));
    let few = Quality { detail: 1, ..Quality::LOW };
    let error = noisy("sb2", [3, 5]).save_compressed(&path, &few).unwrap_err().to_string();
    assert!(error.contains("`detail`"), "{error}");
    assert!(!path.exists());
}

#[test]
fn every_truncation_is_an_error() {
    for model in ["sb2", "sh1"] {
        let bytes = compress(&noisy(model, [12, 20]), &Quality::HIGH);
        for end in 0..bytes.len() {
            refusal(&bytes[..end]);
        }
    }
}

/// The file with another entry `key` in its metadata, or without it.
fn with_metadata(bytes: &[u8], key: &str, edit: impl Fn(&str) -> Option<String>) -> Vec<u8> {
    let (_, header) = SafeTensors::read_metadata(bytes).unwrap();
    let mut metadata = header.metadata().clone().unwrap();
    let old = metadata.remove(key).unwrap();
    metadata.extend(edit(&old).map(|new| (key.to_owned(), new)));
    let file = SafeTensors::deserialize(bytes).unwrap();
    safetensors::serialize(file.tensors(), Some(metadata)).unwrap()
}

#[test]
fn headers_that_lie_are_told() {
    let bytes = compress(&noisy("sb2", [12, 20]), &Quality::MEDIUM);
    assert_eq!(parse(&with_metadata(&bytes, LAYOUT, |old| Some(old.to_owned()))).unwrap(), parse(&bytes).unwrap());
    let replaced = |from: &'static str, to: &'static str| {
        refusal(&with_metadata(&bytes, LAYOUT, |old| {
            assert!(old.contains(from), "{old}");
            Some(old.replace(from, to))
        }))
    };
    for (from, to, expected) in [
        (r#""surfels":12"#, r#""surfels":13"#, "`surfels.positions`"),
        (r#""surfels":12"#, r#""surfels":0"#, "`surfels.positions`"),
        (r#""gaussians":20"#, r#""gaussians":100000"#, "`gaussians.positions`"),
        (r#""gaussians":20"#, r#""gaussians":9223372036854775808"#, "may hold"),
        (r#""gaussians":20"#, r#""gaussians":18446744073709551615"#, "may hold"),
        (r#""gaussians":20"#, r#""gaussians":18446744073709551616"#, "metadata `compressed`"),
        (r#""gaussians":20"#, r#""gaussians":-1"#, "metadata `compressed`"),
        (r#""block_len":2048"#, r#""block_len":0"#, "`block_len`"),
        (r#""block_len":2048"#, r#""block_len":5"#, "tensor `surfels."),
        (r#""positions":12"#, r#""positions":25"#, "`positions` is 25 bits"),
        (r#""positions":12"#, r#""positions":0"#, "`positions` is 0 bits"),
        (r#""positions":12"#, r#""positions":8"#, "tensor `surfels.positions`"),
        (r#""quaternions":7"#, r#""quaternions":4"#, "tensor `surfels.quaternions`"),
        (r#""surfels":12"#, r#""surfels":12,"more":1"#, "metadata `compressed`"),
    ] {
        let found = replaced(from, to);
        assert!(found.contains(expected), "{to}: {found}");
    }
    let without = |key: &str| refusal(&with_metadata(&bytes, key, |_| None));
    assert!(without(LAYOUT).contains("metadata `compressed` is missing"));
    assert!(without("info").contains("metadata `info` is missing"));
    let newer = refusal(&with_metadata(&bytes, "version", |_| Some("2".to_owned())));
    assert!(newer.contains("version 2 is unknown, expected 1"), "{newer}");
    let other = with_metadata(&bytes, "format", |_| Some("dpges-scene".to_owned()));
    assert!(refusal(&other).contains("version 1 is unknown, expected 3 or 2"));
    let other = refusal(&with_metadata(&other, "version", |_| Some("2".to_owned())));
    assert!(other.contains("`surfels."), "{other}");
    let other_model = refusal(&with_metadata(&bytes, "info", |old| Some(old.replace("sb2", "sh2"))));
    assert!(other_model.contains("`surfels.colour.detail` is missing"), "{other_model}");
    let fewer_lobes = refusal(&with_metadata(&bytes, "info", |old| Some(old.replace("sb2", "sb1"))));
    assert!(fewer_lobes.contains("`surfels.colour.lobe"), "{fewer_lobes}");
}

#[test]
fn tensors_that_are_missing_or_of_another_type_are_named() {
    let bytes = compress(&noisy("sb2", [12, 20]), &Quality::MEDIUM);
    let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let names: Vec<String> = file.names().into_iter().map(|name| name.to_string()).collect();
    let kept = GaussianData::ATTRIBUTES.iter().filter(|attribute| !attribute.is_left_out("sb2".parse().unwrap()));
    assert_eq!(names.len(), SurfelData::ATTRIBUTES.len() + kept.count() + 2);
    for name in names {
        let others = file.tensors().into_iter().filter(|(other, _)| *other != name);
        let missing = safetensors::serialize(others, header.metadata().clone()).unwrap();
        assert!(refusal(&missing).contains(&format!("tensor `{name}` is missing")));
        let floats = [0.0f32.to_le_bytes(); 8].concat();
        let wrong = safetensors::tensor::TensorView::new(safetensors::Dtype::F32, vec![8], &floats).unwrap();
        let others = file.tensors().into_iter().filter(|(other, _)| *other != name);
        let typed = safetensors::serialize(others.chain([(name.clone(), wrong)]), header.metadata().clone()).unwrap();
        assert!(refusal(&typed).contains(&format!("`{name}` has element type F32, expected U8")));
    }
}
