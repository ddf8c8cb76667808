//! Opening scenes without stopping the window.

use std::path::Path;
use std::sync::Arc;

use dpges_core::camera::Camera;
use dpges_core::scene::{SceneData, SceneInfo};

use super::views::{DatasetViews, Views};
use crate::export;
use crate::stream::{DEFAULT_BUDGET, Levels, is_lod};

const SCENE_OF_RUN: &str = "scene.safetensors";

/// A scene, and the views that it is compared with.
pub struct Opened {
    /// The scene, or its coarsest level.
    pub scene: SceneData,
    /// How it is drawn at first: as it was trained, or in less time.
    pub drawn: SceneInfo,
    /// The finer levels of a scene in levels of detail.
    pub levels: Option<Levels>,
    pub views: Views,
}

impl Opened {
    pub fn whole(scene: SceneData, views: Views) -> Self {
        Self { drawn: scene.info.clone(), scene, levels: None, views }
    }

    /// Without `views`, those that the scene was exported with.
    pub fn levels(levels: Levels, views: Views) -> Self {
        let views = match views {
            Views::None if !levels.cameras().is_empty() => {
                let named = |(at, camera): (usize, &Camera)| (format!("view {}", at + 1), *camera);
                let cameras = levels.cameras().iter().enumerate().map(named).collect();
                Views::Ready(DatasetViews { cameras, photograph: Box::new(|_| None) })
            }
            views => views,
        };
        let scene = levels.scene().coarse().clone();
        Self { drawn: scene.info.clone(), scene, levels: Some(levels), views }
    }
}

/// Reads a scene file or the folder of a run; the error is what the window says.
pub type Opener = Arc<dyn Fn(&Path) -> Result<Opened, String> + Send + Sync>;

/// Reads the scene file or the splats, or the scene of the run, without views, or opens the scene in levels of detail.
pub fn open_scene(path: &Path) -> Result<Opened, String> {
    if is_lod(path) {
        let levels = Levels::open(path, DEFAULT_BUDGET).map_err(|error| error.to_string())?;
        return Ok(Opened::levels(levels, Views::None));
    }
    let file = if path.is_dir() { path.join(SCENE_OF_RUN) } else { path.to_owned() };
    let opened = export::open(&file).map_err(|error| error.to_string())?;
    Ok(Opened::whole(opened.scene, Views::None))
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::lod::CAMERAS;

    use super::*;
    use crate::fixtures::camera;
    use crate::path::CameraPath;
    use crate::stream::fixtures::{filled, forest, write};

    #[test]
    fn errors_name_the_file() {
        let folder = tempfile::tempdir().unwrap();
        for path in [folder.path().to_owned(), folder.path().join("absent.safetensors")] {
            let error = open_scene(&path).err().unwrap();
            assert!(error.contains(".safetensors"), "{error}");
        }
        let file = folder.path().join("photo.jpg");
        std::fs::write(&file, "no scene").unwrap();
        assert!(open_scene(&file).err().unwrap().contains("photo.jpg"));
    }

    #[test]
    fn scenes_in_levels_of_detail_are_shown_with_their_cameras() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), forest(1, 1), |index, cell| filled(index, cell, [5, 50 + cell]));
        assert!(matches!(open_scene(folder.path()).unwrap().views, Views::None));
        let cameras = vec![camera([4.0, 0.0, 1.0], 50.0), camera([0.0, 4.0, 1.5], 60.0)];
        std::fs::write(folder.path().join(CAMERAS), CameraPath::new(cameras, false).unwrap().to_json()).unwrap();
        let Views::Ready(views) = open_scene(folder.path()).unwrap().views else { panic!("there are two cameras") };
        let names: Vec<&str> = views.cameras.iter().map(|(name, _)| &**name).collect();
        assert_eq!(names, ["view 1", "view 2"]);
    }
}
