//! Which values make sense.

use super::{Config, ConfigError};

/// Largest number of layers that are peeled.
pub const MAX_LAYERS: usize = 8;

impl Config {
    /// # Errors
    /// [`ConfigError::Range`] naming the first key that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let Self { data, train, model, init, stages, discs, relocation, optimizer, refine } = self;
        at_least("data.image_scale", data.image_scale as usize, 1)?;
        not_negative("data.near", data.near)?;

        at_least("train.steps", train.steps, 1)?;
        at_least("train.patience", train.patience, 1)?;
        if train.seed > i64::MAX as u64 {
            return Err(out_of_range("train.seed", train.seed, format!("at most {}", i64::MAX)));
        }
        not_negative("train.lambda_surfel", train.lambda_surfel)?;
        not_negative("train.lambda_scale", train.lambda_scale)?;
        not_negative("train.lambda_transmittance", train.lambda_transmittance)?;
        fraction("train.lambda_dssim", train.lambda_dssim)?;
        not_negative("train.lambda_depth", train.lambda_depth)?;
        not_negative("train.lambda_normal", train.lambda_normal)?;
        not_negative("train.lambda_depth_normal", train.lambda_depth_normal)?;

        if !(1..=MAX_LAYERS).contains(&model.layers) {
            return Err(out_of_range("model.layers", model.layers, format!("from 1 to {MAX_LAYERS}")));
        }
        positive("model.modulation", model.modulation)?;

        at_least("init.max_points", init.max_points, 1)?;
        positive("init.surfel_scale", init.surfel_scale)?;
        positive("init.gaussian_scale", init.gaussian_scale)?;
        positive("init.max_scale_extent", init.max_scale_extent)?;
        positive("init.max_scale_median", init.max_scale_median)?;
        positive("init.gaussian_opacity", init.gaussian_opacity)?;
        at_least("init.random_gaussians", init.random_gaussians, 1)?;
        if !(8..=512).contains(&init.hull_resolution) {
            return Err(out_of_range("init.hull_resolution", init.hull_resolution, "from 8 to 512".to_owned()));
        }
        fraction("init.hull_tolerance", init.hull_tolerance)?;

        fraction("stages.surfels", stages.surfels)?;
        fraction("stages.gaussians", stages.gaussians)?;
        if stages.surfels + stages.gaussians >= 1.0 {
            let found = format!("{} + {}", stages.surfels, stages.gaussians);
            return Err(out_of_range("stages.surfels + stages.gaussians", found, "a sum below 1".to_owned()));
        }
        fraction("stages.surfel_opacity", stages.surfel_opacity)?;
        positive("stages.surfel_scale", stages.surfel_scale)?;
        positive("stages.surfel_budget", stages.surfel_budget)?;
        fraction("stages.surfel_budget", stages.surfel_budget)?;
        positive("stages.gaussian_budget", stages.gaussian_budget)?;
        fraction("stages.gaussian_budget", stages.gaussian_budget)?;
        not_negative("stages.opacities", stages.opacities)?;
        fraction("stages.position_share", stages.position_share)?;

        at_least("discs.densify_every", discs.densify_every, 1)?;
        positive("discs.gradient_threshold", discs.gradient_threshold)?;
        positive("discs.clone_scale", discs.clone_scale)?;
        fraction("discs.min_opacity", discs.min_opacity)?;
        positive("discs.max_scale", discs.max_scale)?;
        at_least("discs.reset_every", discs.reset_every, 1)?;
        opacity("discs.reset_opacity", discs.reset_opacity)?;
        not_negative("discs.lambda_normal", discs.lambda_normal)?;
        not_negative("discs.lambda_distortion", discs.lambda_distortion)?;
        opacity("discs.start_opacity", discs.start_opacity)?;
        positive("discs.start_scale", discs.start_scale)?;

        at_least("relocation.every", relocation.every, 1)?;
        check("relocation.growth", relocation.growth, relocation.growth >= 1.0, "a finite number of at least 1")?;
        opacity("relocation.min_opacity", relocation.min_opacity)?;
        not_negative("relocation.lambda_opacity", relocation.lambda_opacity)?;
        not_negative("relocation.lambda_scale", relocation.lambda_scale)?;
        not_negative("relocation.noise", relocation.noise)?;
        opacity("relocation.start_opacity", relocation.start_opacity)?;
        positive("relocation.start_scale", relocation.start_scale)?;

        positive("optimizer.position_start", optimizer.position_start)?;
        positive("optimizer.position_end", optimizer.position_end)?;
        not_negative("optimizer.surfel_position_factor", optimizer.surfel_position_factor)?;
        not_negative("optimizer.quaternions", optimizer.quaternions)?;
        not_negative("optimizer.log_scales", optimizer.log_scales)?;
        not_negative("optimizer.opacities", optimizer.opacities)?;
        not_negative("optimizer.base", optimizer.base)?;
        not_negative("optimizer.detail", optimizer.detail)?;
        positive("optimizer.decay", optimizer.decay)?;
        below_one("optimizer.beta1", optimizer.beta1)?;
        below_one("optimizer.beta2", optimizer.beta2)?;
        positive("optimizer.epsilon", optimizer.epsilon)?;

        at_least("refine.surfel_prune_every", refine.surfel_prune_every, 1)?;
        positive("refine.surfel_max_scale", refine.surfel_max_scale)?;
        at_least("refine.gaussian_prune_every", refine.gaussian_prune_every, 1)?;
        not_negative("refine.gaussian_min_contribution", refine.gaussian_min_contribution)?;
        at_least("refine.add_every", refine.add_every, 1)?;
        at_least("refine.split_every", refine.split_every, 1)?;
        positive("refine.split_factor", refine.split_factor)
    }
}

fn out_of_range(key: &'static str, found: impl ToString, expected: String) -> ConfigError {
    ConfigError::Range { key, found: found.to_string(), expected }
}

fn at_least(key: &'static str, found: usize, least: usize) -> Result<(), ConfigError> {
    if found >= least { Ok(()) } else { Err(out_of_range(key, found, format!("at least {least}"))) }
}

fn check(key: &'static str, found: f64, ok: bool, expected: &str) -> Result<(), ConfigError> {
    if ok && found.is_finite() { Ok(()) } else { Err(out_of_range(key, found, expected.to_owned())) }
}

fn positive(key: &'static str, found: f64) -> Result<(), ConfigError> {
    check(key, found, found > 0.0, "a positive, finite number")
}

fn not_negative(key: &'static str, found: f64) -> Result<(), ConfigError> {
    check(key, found, found >= 0.0, "a finite number of at least 0")
}

fn fraction(key: &'static str, found: f64) -> Result<(), ConfigError> {
    check(key, found, (0.0..=1.0).contains(&found), "a number from 0 to 1")
}

fn opacity(key: &'static str, found: f64) -> Result<(), ConfigError> {
    check(key, found, found > 0.0 && found < 1.0, "a number between 0 and 1")
}

fn below_one(key: &'static str, found: f64) -> Result<(), ConfigError> {
    check(key, found, (0.0..1.0).contains(&found), "a number of at least 0 and below 1")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_in_range_and_each_bad_value_is_named() {
        Config::default().validate().unwrap();
        type Spoil = fn(&mut Config);
        let bad: [(&str, Spoil); 9] = [
            ("train.steps", |c| c.train.steps = 0),
            ("train.seed", |c| c.train.seed = u64::MAX),
            ("train.lambda_dssim", |c| c.train.lambda_dssim = 1.5),
            ("model.layers", |c| c.model.layers = 0),
            ("model.layers", |c| c.model.layers = 9),
            ("init.hull_resolution", |c| c.init.hull_resolution = 100_000),
            ("optimizer.log_scales", |c| c.optimizer.log_scales = -1e-3),
            ("optimizer.beta2", |c| c.optimizer.beta2 = 1.0),
            ("model.modulation", |c| c.model.modulation = f64::NAN),
        ];
        for (key, spoil) in bad {
            let mut config = Config::default();
            spoil(&mut config);
            let error = config.validate().unwrap_err().to_string();
            assert!(error.contains(&format!("`{key}`")), "{error}");
        }
    }
}
