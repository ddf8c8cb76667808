//! Protocol that all cells of a benchmark share.

use clap::builder::TypedValueParser;
use clap::{Args, value_parser};
use dpges_train::config::stages::factor;
use dpges_train::config::{Config, ConfigError};
use dpges_train::dataset::MaxResolution;
use serde_json::{Map, Value};

/// Checkpoints of a run.
const CHECKPOINTS: usize = 20;
/// Interval of evaluations for flexible stopping (DBS).
const STOPPING_EVERY: usize = 500;
/// Evaluations in a row that may be no better (DBS).
const STOPPING_PATIENCE: usize = 20;

#[derive(Args, Clone, Debug, PartialEq)]
pub struct Protocol {
    /// Factor on the published steps of every method
    #[arg(long, value_name = "F", default_value_t = 1.0, value_parser = factor)]
    pub steps_scale: f64,
    /// Longest side of photographs, px [default: as published]
    #[arg(long, value_name = "N", value_parser = value_parser!(u32).range(1..).map(|px| MaxResolution(px as usize)))]
    pub max_resolution: Option<MaxResolution>,
    /// Give 3DGS-MCMC, DBS and SSS the numbers of primitives of their own publications, not that of DP-GES
    #[arg(long)]
    pub own_caps: bool,
    /// Keep every eighth training view, and end a run that no longer improves it
    #[arg(long)]
    pub flexible_stopping: bool,
    /// Number of seeds, from 0
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = value_parser!(u64).range(1..=1000))]
    pub seeds: u64,
}

impl Default for Protocol {
    fn default() -> Self {
        Self { steps_scale: 1.0, max_resolution: None, own_caps: false, flexible_stopping: false, seeds: 1 }
    }
}

impl Protocol {
    /// As options of `dpges benchmark`.
    pub fn arguments(&self) -> Vec<String> {
        let mut arguments = vec![format!("--steps-scale={}", self.steps_scale), format!("--seeds={}", self.seeds)];
        arguments.extend(self.max_resolution.map(|most| format!("--max-resolution={}", most.0)));
        arguments.extend(self.own_caps.then(|| "--own-caps".to_owned()));
        arguments.extend(self.flexible_stopping.then(|| "--flexible-stopping".to_owned()));
        arguments
    }

    /// The subject that rows must share to be in one table.
    pub fn subject(&self) -> Map<String, Value> {
        Map::from_iter([
            ("steps_scale".to_owned(), Value::from(self.steps_scale)),
            ("max_resolution".to_owned(), self.max_resolution.map(|most| most.0).into()),
            ("own_caps".to_owned(), Value::from(self.own_caps)),
            ("flexible_stopping".to_owned(), Value::from(self.flexible_stopping)),
        ])
    }

    /// `key=value` of a run with this seed, but for its length.
    pub fn settings(&self, seed: u64) -> Vec<String> {
        let mut settings = vec![format!("train.seed={seed}")];
        settings.extend(self.max_resolution.map(|most| format!("data.max_resolution={}", most.0)));
        if self.flexible_stopping {
            settings.push("train.stop=validation".to_owned());
            settings.push(format!("train.patience={STOPPING_PATIENCE}"));
        }
        settings
    }

    /// Gives a run its length, and the intervals that follow from it. Evaluations on the way would count as training time, so
    /// there are none that nothing depends on.
    ///
    /// # Errors
    /// Those of [`Config::scale_steps`].
    pub fn scale(&self, config: &mut Config) -> Result<(), ConfigError> {
        config.scale_steps(self.steps_scale)?;
        config.train.checkpoint_every = (config.train.steps / CHECKPOINTS).max(1);
        let evaluates = (STOPPING_EVERY as f64 * self.steps_scale).round() as usize;
        config.train.evaluate_every = if self.flexible_stopping { evaluates.max(1) } else { 0 };
        Ok(())
    }

    /// In words.
    pub fn sentences(&self) -> [&'static str; 3] {
        let primitives = if self.own_caps {
            "Methods that relocate Gaussians have as many as in their own publications; where these do not say how many, it is \
             the budget of the preset of the dataset."
        } else {
            "Methods that relocate Gaussians have as many primitives as DP-GES, as in the paper; how many that is per scene is \
             not published, so it is the budget of the preset of the dataset."
        };
        let stopping = if self.flexible_stopping {
            "Every eighth training view is kept from training and ends a run that no longer improves it; in the paper held-out \
             views do."
        } else {
            "Runs have a fixed length, and held-out views decide nothing; in the paper a run is the best of its evaluations on \
             held-out views."
        };
        [
            "Pictures are compared with 8 bits per channel. LPIPS is that of VGG16 with pictures from 0 to 1.",
            primitives,
            stopping,
        ]
    }
}

#[cfg(test)]
mod tests {
    use dpges_train::config::Stop;

    use super::*;

    #[test]
    fn validation_views_end_runs_if_that_is_asked_for() {
        let run = |protocol: &Protocol| {
            let mut config = Config::resolve(None, None, &protocol.settings(4)).unwrap();
            protocol.scale(&mut config).unwrap();
            config
        };
        let flexible = Protocol { flexible_stopping: true, steps_scale: 0.1, ..Protocol::default() };
        let config = run(&flexible);
        assert_eq!((config.train.stop, config.train.patience, config.train.evaluate_every), (Stop::Validation, 20, 50));
        assert_eq!((config.train.seed, config.train.steps, config.train.checkpoint_every), (4, 500, 25));
        assert_eq!(run(&Protocol::default()).train.stop, Stop::Steps);
    }

    #[test]
    fn arguments_name_what_is_asked_for_and_nothing_else() {
        assert_eq!(Protocol::default().arguments(), ["--steps-scale=1", "--seeds=1"]);
        let max_resolution = Some(MaxResolution(64));
        let all = Protocol { steps_scale: 0.25, max_resolution, own_caps: true, flexible_stopping: true, seeds: 3 };
        let expected = ["--steps-scale=0.25", "--seeds=3", "--max-resolution=64", "--own-caps", "--flexible-stopping"];
        assert_eq!(all.arguments(), expected);
        assert_ne!(all.subject(), Protocol { own_caps: false, ..all.clone() }.subject());
        assert_eq!(all.subject(), Protocol { seeds: 1, ..all.clone() }.subject(), "more seeds are more rows");
    }
}
