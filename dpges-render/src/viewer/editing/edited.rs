//! The scene that is edited, as it was opened, and what is deleted of it.

use std::path::Path;

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use glam::{DVec2, DVec3};

use super::marks::{Combine, Marks};
use super::region::{Region, rows_within};

/// Selected primitives that are marked in the picture, at most: of more, every second, third, ….
const MOST_MARKED: usize = 50_000;

pub struct EditedScene {
    scene: SceneData,
    /// Rows are surfels, then Gaussians.
    pub marks: Marks,
    /// The primitives that were deleted when the scene was saved last.
    saved: Vec<bool>,
}

impl EditedScene {
    pub fn new(scene: SceneData) -> Self {
        let marks = Marks::new(scene.surfels.len() + scene.gaussians.len());
        Self { saved: marks.deleted().to_vec(), scene, marks }
    }

    pub fn is_saved(&self) -> bool {
        self.saved == self.marks.deleted()
    }

    /// The primitives that are not deleted.
    pub fn kept(&self) -> SceneData {
        let (of_surfels, of_gaussians) = self.marks.deleted().split_at(self.scene.surfels.len());
        let rows = |deleted: &[bool]| -> Vec<usize> { (0..deleted.len()).filter(|&row| !deleted[row]).collect() };
        SceneData {
            info: self.scene.info.clone(),
            surfels: self.scene.surfels.select(&rows(of_surfels)),
            gaussians: self.scene.gaussians.select(&rows(of_gaussians)),
            environment: self.scene.environment.clone(),
        }
    }

    /// Selects what `camera` shows within `region`: see [`rows_within`].
    pub fn select(&mut self, region: &Region, camera: &Camera, surfaces: Option<&[f32]>, combine: Combine) {
        let (surfels, gaussians) = (&self.scene.surfels, &self.scene.gaussians);
        let mut rows = rows_within(&surfels.positions, camera, region, surfaces);
        let of_gaussians = rows_within(&gaussians.positions, camera, region, surfaces);
        rows.extend(of_gaussians.into_iter().map(|row| surfels.len() + row));
        self.marks.select(rows, combine);
    }

    /// Where `camera` shows the centres of what is selected, px.
    pub fn selected_at(&self, camera: &Camera) -> impl Iterator<Item = DVec2> {
        let (surfels, gaussians) = (&self.scene.surfels.positions, &self.scene.gaussians.positions);
        let positions = surfels.as_chunks::<3>().0.iter().chain(gaussians.as_chunks::<3>().0);
        let marked = positions.zip(self.marks.selected()).filter(|(_, selected)| **selected);
        let places =
            marked.step_by(self.marks.selected_count().div_ceil(MOST_MARKED).max(1)).filter_map(|(position, _)| {
                let (x, y, _) = camera.project(DVec3::from(position.map(f64::from)))?;
                Some(DVec2::new(x, y))
            });
        let (width, height) = (camera.width as f64, camera.height as f64);
        places.filter(move |at| (0.0..width).contains(&at.x) && (0.0..height).contains(&at.y))
    }

    /// Writes what is not deleted as a scene file, in place of one that may be there.
    ///
    /// # Errors
    /// A sentence.
    pub fn save(&mut self, file: &Path) -> Result<String, String> {
        if file.extension().is_none_or(|extension| extension != "safetensors") {
            let name = file.with_extension("safetensors");
            return Err(format!(
                "{} is no name of a scene file: name it {}; `dpges export` writes splats",
                file.display(),
                name.display()
            ));
        }
        let kept = self.kept();
        let (surfels, gaussians) = (kept.surfels.len(), kept.gaussians.len());
        if surfels + gaussians == 0 {
            return Err("All is deleted: there is nothing to save.".to_owned());
        }
        kept.save(file).map_err(|error| error.to_string())?;
        self.saved = self.marks.deleted().to_vec();
        Ok(format!("{surfels} surfels, {gaussians} Gaussians in {}", file.display()))
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::SceneInfo;

    use super::*;
    use crate::fixtures::{camera, neutral};

    fn scene() -> SceneData {
        let mut scene = neutral(SceneInfo::default(), [3, 2]);
        scene.surfels.positions = (0..9).map(|at| 0.1 * at as f32).collect();
        scene.gaussians.positions = (0..6).map(|at| -0.1 * at as f32).collect();
        scene.gaussians.log_scales = (0..6).map(|at| -4.0 - at as f32).collect();
        scene
    }

    #[test]
    fn what_is_deleted_is_missing_in_the_file_and_comes_back_byte_for_byte() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("edited.safetensors");
        let mut edited = EditedScene::new(scene());
        edited.marks.select([1, 4], Combine::Replace);
        edited.marks.delete();
        assert!(!edited.is_saved());
        let note = edited.save(&file).unwrap();
        assert!(note.contains("2 surfels, 1 Gaussians") && note.contains("edited.safetensors"), "{note}");
        assert!(edited.is_saved());
        let expected = SceneData { surfels: scene().surfels.select(&[0, 2]), ..scene() };
        let expected = SceneData { gaussians: scene().gaussians.select(&[0]), ..expected };
        assert_eq!(SceneData::load(&file).unwrap(), expected);
        edited.marks.undo();
        assert!(!edited.is_saved());
        edited.save(&file).unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), scene().to_bytes(&file).unwrap());
        edited.marks.redo();
        assert_eq!(edited.kept(), expected);
    }

    #[test]
    fn nothing_and_other_formats_are_not_saved() {
        let folder = tempfile::tempdir().unwrap();
        let mut edited = EditedScene::new(scene());
        let refused = edited.save(&folder.path().join("a.ply")).unwrap_err();
        assert!(refused.contains("a.safetensors") && refused.contains("dpges export"), "{refused}");
        edited.marks.invert();
        edited.marks.delete();
        let file = folder.path().join("a.safetensors");
        assert!(edited.save(&file).unwrap_err().contains("nothing to save") && !file.exists());
    }

    #[test]
    fn selected_centres_are_marked_where_the_picture_shows_them() {
        let mut edited = EditedScene::new(neutral(SceneInfo::default(), [MOST_MARKED, 2]));
        let camera = camera([4.0, 0.0, 0.0], 50.0);
        assert_eq!(edited.selected_at(&camera).count(), 0);
        edited.marks.select([0, MOST_MARKED], Combine::Replace);
        let places: Vec<DVec2> = edited.selected_at(&camera).collect();
        assert_eq!(places, [DVec2::new(32.0, 24.0); 2]);
        edited.marks.invert();
        edited.marks.select([0], Combine::Add);
        assert_eq!(edited.selected_at(&camera).count(), MOST_MARKED / 2 + 1, "every second");
        edited.scene.surfels.positions.fill(5.0);
        edited.scene.gaussians.positions.fill(5.0);
        assert_eq!(edited.selected_at(&camera).count(), 0, "behind the camera");
    }
}
