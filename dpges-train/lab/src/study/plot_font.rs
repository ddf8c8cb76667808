//! Letters in plots and sheets: the font comes with the program.

use plotters::style::{FontStyle, register_font};

/// Name by which plots ask for the font.
pub const FAMILY: &str = "sans-serif";

/// Makes the font known under its name, as often as it is called.
pub fn register() -> Result<(), String> {
    register_font(FAMILY, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT)
        .map_err(|_| "the font cannot be read".to_owned())
}
