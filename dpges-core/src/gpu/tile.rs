//! Kernels in which a cube handles a tile and a unit handles a pixel.

use cubecl::prelude::*;

use super::launch::{LANES, UNITS};
use super::view::CameraUniforms;
use crate::tiles;

/// Edge of a tile, px.
pub const TILE: u32 = tiles::TILE as u32;
const _: () = assert!(TILE * TILE == UNITS, "one unit per pixel of a tile");

/// A tile consists of regions, each with the pixels of [`LANES`] consecutive units. Sizes in px.
pub const REGION_WIDTH: u32 = tiles::REGION_WIDTH as u32;
pub const REGION_HEIGHT: u32 = tiles::REGION_HEIGHT as u32;
const _: () = assert!(REGION_WIDTH * REGION_HEIGHT == LANES, "one unit per pixel of a region");
/// Regions in a row of a tile, and in a tile.
pub const REGION_COLUMNS: u32 = TILE / REGION_WIDTH;
pub const REGIONS: usize = (UNITS / LANES) as usize;

/// The pixel of a unit.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Pixel {
    /// Whether the pixel lies in the image.
    pub inside: bool,
    /// Position within a plane, 0 outside the image.
    pub at: usize,
    /// Centre, px.
    pub x: f32,
    pub y: f32,
}

/// The pixel of this unit in `tile`.
#[cube]
pub fn own_pixel(view: CameraUniforms, tile: u32) -> Pixel {
    pixel_of(view, tile, UNIT_POS)
}

/// The pixel of a unit in `tile`.
#[cube]
pub fn pixel_of(view: CameraUniforms, tile: u32, unit: u32) -> Pixel {
    let (region, lane) = (unit / LANES, unit % LANES);
    let column = tile % view.columns * TILE + region % REGION_COLUMNS * REGION_WIDTH + lane % REGION_WIDTH;
    let row = tile / view.columns * TILE + region / REGION_COLUMNS * REGION_HEIGHT + lane / REGION_WIDTH;
    let inside = column < view.width && row < view.height;
    Pixel {
        inside,
        // units outside load from pixel 0, in bounds, since they must reach the barriers of their cube
        at: select(inside, row * view.width + column, 0u32) as usize,
        x: f32::cast_from(column) + 0.5f32,
        y: f32::cast_from(row) + 0.5f32,
    }
}

/// Number of pixels in a plane.
#[cube]
pub fn plane_of(view: CameraUniforms) -> usize {
    (view.width * view.height) as usize
}
