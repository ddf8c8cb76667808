//! The guides of `docs/`: how to train, and what to expect.

#[doc = include_str!("../../docs/reference/commands.md")]
pub mod commands {}

#[doc = include_str!("../../docs/guide/capture.md")]
pub mod captures {}

#[doc = include_str!("../../docs/compression.md")]
pub mod compression {}

#[doc = include_str!("../../docs/guide/train.md")]
pub mod stages {}

#[doc = include_str!("../../docs/depth.md")]
pub mod depth {}

#[doc = include_str!("../../docs/exposure.md")]
pub mod exposure {}

#[doc = include_str!("../../docs/poses.md")]
pub mod poses {}

#[doc = include_str!("../../docs/log/2026-11-24-results.md")]
pub mod results {}

#[doc = include_str!("../../docs/guide/measure.md")]
pub mod metrics {}

#[doc = include_str!("../../docs/library.md")]
pub mod library {}

#[doc = include_str!("../../docs/reference/configuration.md")]
pub mod configuration {}

#[doc = include_str!("../../docs/reference/variants.md")]
pub mod ablations {}

#[doc = include_str!("../../docs/guide/comparisons.md")]
pub mod comparisons {}

#[doc = include_str!("../../docs/guide/trade.md")]
pub mod trade {}

#[doc = include_str!("../../docs/popping.md")]
pub mod popping {}

#[doc = include_str!("../../docs/step.md")]
pub mod step {}
