//! Why a scene cannot be exported, or a file not be read.

#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    #[error("harmonics of degree {found} cannot be exported: use a degree from 0 to 3")]
    Degree { found: usize },
    #[error("the scene draws nothing: it has no surfels, and all of its {gaussians} Gaussians are transparent")]
    Empty { gaussians: usize },
    #[error("kernels of Student's t distribution (SSS) cannot be exported: splats of other programs are Gaussians")]
    Kernel,
    #[error(
        "weights of Gaussians that are summed in any order (sort-free Gaussians) have no counterpart in files of splats: nothing \
         of the scene can be exported"
    )]
    Summed,
    #[error("the scene has no surfels, and a mesh is made of them: export the splats instead")]
    NoSurfels,
    #[error(
        "a splat is {found:.3e} world units from the origin, and SPZ holds positions below {limit:.3e}: move the scene \
         nearer to the origin, or export another format"
    )]
    TooFar { found: f64, limit: f64 },
    #[error(
        "{resized} of {count} splats are smaller than {smallest:.3e} or larger than {largest:.3e} world units, the sizes that SPZ \
         holds, and would get another: export SOG or PLY"
    )]
    Sizes { resized: usize, count: usize, smallest: f64, largest: f64 },
    #[error("{count} splats are more than the format can count, at most {limit}")]
    TooMany { count: usize, limit: usize },
    #[error("voxels of {voxel} world units are too small for this scene: it needs more than {limit}; use larger ones")]
    TooManyVoxels { voxel: f64, limit: usize },
    #[error(
        "voxels of {voxel} world units are too small for this scene: there is memory for {limit}; the smallest that fit are of \
         {smallest} world units"
    )]
    SmallestVoxel { voxel: f64, smallest: f64, limit: usize },
    #[error("a voxel of {found} world units is none: use a positive, finite number")]
    Voxel { found: f64 },
    #[error("a view has {found} numbers of {what}, expected {expected} for its {width} × {height} pixels")]
    View { what: &'static str, found: usize, expected: usize, width: usize, height: usize },
    #[error("no surface was found: no view shows a surfel, or the voxels are larger than all of them")]
    NoSurface,
    #[error("{format} file: {reason}")]
    Malformed { format: &'static str, reason: String },
}
