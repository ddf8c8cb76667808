//! Keys of earlier versions, which are refused with what has become of them.

use toml::Value;

const CONSTANT: &str = "it is a constant of the method now, with the value that it had by default";
const SFM: &str = "an option of the command says it now, such as --sfm, --sfm-camera, --sfm-matching or --video-frames";

/// Section, keys, and what has become of them. CHANGELOG.md has the same as a table.
const FORMER: [(&str, &str, &str); 26] = [
    ("data", "builtin_lens", "the name of the dataset says it now: builtin:lens=fisheye"),
    ("data", "builtin_exposure_stops", "the name of the dataset says it now: builtin:exposure_stops=0.5"),
    ("data", "builtin_pose_degrees", "the name of the dataset says it now: builtin:pose_degrees=0.2"),
    ("data", "builtin_pose_extents", "the name of the dataset says it now: builtin:pose_extents=0.005"),
    ("data", "sfm sfm_camera sfm_matching video_frames", SFM),
    ("train", "deterministic", "every run is, and the key changed nothing"),
    ("train", "lambda_depth", "it is called train.lambda_disc_depth"),
    ("train", "lambda_normal", "it is called train.lambda_disc_normal"),
    ("train", "lambda_depth_normal", "it is called train.lambda_disc_depth_normal"),
    ("train", "picture_views", "it is a constant now, 3 views"),
    ("init", "surfel_scale gaussian_scale gaussian_opacity hull_tolerance", CONSTANT),
    ("init", "max_scale_extent max_scale_median", "init.limit_scales turns both limits off or on"),
    ("stages", "opacities", CONSTANT),
    ("discs", "gradient_threshold", "it is called density.gradient_threshold"),
    ("discs", "by_quantile", "it follows from stages.gaussians_by now: discs of DP-GES (\"dbs\") do without"),
    ("discs", "densify_every densify_from densify_until clone_scale dense_fraction min_opacity max_scale", CONSTANT),
    (
        "discs",
        "max_scale_from reset_every reset_opacity normal_from distortion_from start_opacity start_scale",
        CONSTANT,
    ),
    ("density", "smoothing", "it is called model.sampling_limit"),
    ("density", "every from until absolute_threshold dense_fraction absolute_dense_fraction min_opacity", CONSTANT),
    ("density", "max_scale max_scale_from reset_every reset_opacity degree_every start_opacity start_scale", CONSTANT),
    ("relocation", "every from until growth min_opacity lambda_scale noise start_opacity", CONSTANT),
    ("optimizer", "surfel_position_factor beta1 beta2 epsilon decay_from", CONSTANT),
    ("optimizer", "pose_rotation pose_translation", "both are called optimizer.poses"),
    ("refine", "surfel_min_pixels surfel_pixels_of", "both are refine.surfel_pixels now: \"16px/MP\" or \"16px\""),
    ("refine", "split", "refine.split_until=0 splits no Gaussians"),
    ("refine", "margins_with_pruning surfel_max_scale least_gain drop_lobes_at", CONSTANT),
];

/// Replacement of the former key `name`, such as `train.deterministic`, in words; `None` if no earlier version had it.
pub fn instead(name: &str) -> Option<&'static str> {
    let (section, key) = name.split_once('.')?;
    let is_it = |keys: &str| keys.split(' ').any(|former| former == key);
    FORMER.iter().find(|(of, keys, _)| *of == section && is_it(keys)).map(|(.., instead)| *instead)
}

/// Whether an earlier version had a section of this name.
pub fn had_section(name: &str) -> bool {
    FORMER.iter().any(|(section, ..)| *section == name)
}

/// Whether a dataset is read as it was without the former `key` of `[data]`. Run folders name every key of their version.
pub fn dataset_does_without(key: &str, value: &Value) -> bool {
    let of_photographs = instead(&format!("data.{key}")) == Some(SFM);
    let changes_nothing = value.as_str() == Some("none") || value.as_float() == Some(0.0);
    of_photographs || (key.starts_with("builtin_") && changes_nothing)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::keys;

    #[test]
    fn former_keys_are_none_today_and_what_replaces_them_is() {
        let is_key = |name: &str| keys().any(|key| key.name == name);
        for (section, former, instead) in FORMER {
            assert!(former.split(' ').all(|key| !is_key(&format!("{section}.{key}"))), "{section} {former:?}");
            let words = instead.split_whitespace().map(|word| word.split('=').next().unwrap_or(word));
            let names = words.map(|word| word.trim_end_matches([',', ':'])).filter(|word| {
                let section = word.split_once('.').map(|(section, _)| section);
                section.is_some_and(|section| !section.is_empty() && section.chars().all(|c| c.is_ascii_lowercase()))
            });
            names.for_each(|name| assert!(is_key(name), "{name}: {instead}"));
        }
    }
}
