//! The guides, the reference and the research notes of `docs/`.

/// How to use the program.
pub mod guide {
    #[doc = include_str!("../../docs/guide/capture.md")]
    pub mod capture {}

    #[doc = include_str!("../../docs/guide/train.md")]
    pub mod train {}

    #[doc = include_str!("../../docs/guide/measure.md")]
    pub mod measure {}
}

/// Generated lists of commands, keys and variants.
pub mod reference {
    #[doc = include_str!("../../docs/reference/commands.md")]
    pub mod commands {}

    #[doc = include_str!("../../docs/reference/configuration.md")]
    pub mod configuration {}

    #[doc = include_str!("../../docs/reference/variants.md")]
    pub mod variants {}
}

#[doc = include_str!("../../docs/log/README.md")]
pub mod log {
    #[doc = include_str!("../../docs/log/2026-11-24-results.md")]
    pub mod results {}

    #[doc = include_str!("../../docs/log/2026-11-24-benchmarks.md")]
    pub mod benchmarks {}

    #[doc = include_str!("../../docs/log/2026-11-23-trade.md")]
    pub mod trade {}

    #[doc = include_str!("../../docs/log/2026-11-23-exports-and-captures.md")]
    pub mod exports_and_captures {}

    #[doc = include_str!("../../docs/log/2026-11-22-precision.md")]
    pub mod precision {}
}
