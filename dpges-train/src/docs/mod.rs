//! The guides and the reference of `docs/`.

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
