//! Properties of a scene: counts, its model, percentiles.

use dpges_core::scene::lobes::present;
use dpges_core::scene::{ColourModel, EnvironmentData};
use dpges_render::Up;
use serde_json::{Value, json};

use super::scene::Scene;

const PERCENTILES: [usize; 3] = [5, 50, 95];

/// Names and values; null where a scene has none.
pub fn describe(scene: &Scene) -> Vec<(&'static str, Value)> {
    let (info, surfels, gaussians) = (&scene.data.info, &scene.data.surfels, &scene.data.gaussians);
    let positions = || surfels.positions.chunks_exact(3).chain(gaussians.positions.chunks_exact(3));
    let bound = |pick: fn(f32, f32) -> f32| -> Option<[f32; 3]> {
        let first: [f32; 3] = positions().next()?.try_into().ok()?;
        Some(positions().fold(first, |bound, point| std::array::from_fn(|axis| pick(bound[axis], point[axis]))))
    };
    let scales = |log_scales: &[f32]| percentiles(log_scales.iter().map(|value| value.exp()).collect());
    let choices = serde_json::to_value(info).unwrap_or_default();
    let choice = |name: &str| choices[name].clone();
    vec![
        ("scene", json!(scene.path.display().to_string())),
        ("bytes", json!(scene.bytes)),
        ("surfels", json!(surfels.len())),
        ("gaussians", json!(gaussians.len())),
        ("colour_model", json!(info.colour_model.to_string())),
        ("lobes", json!(lobes(scene))),
        ("rendering", json!(info.rendering.to_string())),
        ("screen_filter", choice("screen_filter")),
        ("blend_order", json!(info.blend_order.to_string())),
        ("layers", json!(info.layer_count)),
        ("modulation", json!(info.modulation)),
        ("footprint", choice("footprint")),
        ("peeling", choice("peeling")),
        ("background", json!(info.background)),
        ("environment", json!(scene.data.environment.as_ref().map(|e| EnvironmentData::degree_of(e.len())))),
        ("extent", json!(info.extent)),
        ("near", json!(info.near)),
        ("metres_per_unit", json!(info.metres_per_unit)),
        ("offset", json!(info.offset)),
        ("up", json!(Up::of(info).to_string())),
        ("bounding_box_min", json!(bound(f32::min))),
        ("bounding_box_max", json!(bound(f32::max))),
        ("percentiles", json!(PERCENTILES)),
        ("surfel_scales", json!(scales(&surfels.log_scales))),
        ("surfel_margins", json!(percentiles(surfels.margins.clone()))),
        ("gaussian_scales", json!(scales(&gaussians.log_scales))),
        ("gaussian_opacities", json!(percentiles(gaussians.opacities.clone()))),
    ]
}

/// Names and values as text.
pub fn rows(entries: &[(&'static str, Value)]) -> Vec<(&'static str, String)> {
    entries.iter().map(|(name, value)| (*name, text(value))).collect()
}

fn text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Null => "none".to_owned(),
        Value::Array(values) => values.iter().map(text).collect::<Vec<_>>().join("  "),
        Value::Number(number) if number.is_f64() => match number.as_f64().unwrap_or(f64::NAN) {
            small if small != 0.0 && small.abs() < 0.01 => format!("{small:.3e}"),
            other => format!("{other:.4}"),
        },
        other => other.to_string(),
    }
}

/// Numbers of lobes of the surfels and of the Gaussians; `None` for colours without lobes.
fn lobes(scene: &Scene) -> Option<[usize; 2]> {
    let ColourModel::SphericalBeta { lobes } = scene.data.info.colour_model else { return None };
    let (surfels, gaussians) = (&scene.data.surfels, &scene.data.gaussians);
    let sets = [(&surfels.colour.detail, surfels.len()), (&gaussians.colour.detail, gaussians.len())];
    Some(sets.map(|(detail, count)| present(detail, count, lobes).into_iter().map(usize::from).sum()))
}

/// `None` without values.
fn percentiles(mut values: Vec<f32>) -> Option<[f32; 3]> {
    values.sort_unstable_by(f32::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some(PERCENTILES.map(|percent| values[(percent * last + 50) / 100]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_values_that_occur() {
        assert_eq!(percentiles((0..=100).rev().map(|value| value as f32).collect()), Some([5.0, 50.0, 95.0]));
        assert_eq!(percentiles(vec![2.0]), Some([2.0; 3]));
        assert_eq!(percentiles(Vec::new()), None);
    }
}
