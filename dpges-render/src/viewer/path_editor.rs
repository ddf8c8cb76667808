//! A camera path in the making.

use std::path::Path;

use dpges_core::camera::Camera;
use dpges_core::scene::SceneInfo;

use crate::path::{CameraPath, PathError};

pub struct PathEditor {
    pub cameras: Vec<Camera>,
    /// Time for the whole path, s.
    pub seconds: f64,
    pub file: String,
    /// Time since the preview began, s; `None`: it does not play.
    playing: Option<f64>,
}

impl Default for PathEditor {
    fn default() -> Self {
        Self { cameras: Vec::new(), seconds: 6.0, file: "path.json".to_owned(), playing: None }
    }
}

impl PathEditor {
    pub fn reorder(&mut self, from: usize, to: usize) {
        if from < self.cameras.len() && to < self.cameras.len() {
            let camera = self.cameras.remove(from);
            self.cameras.insert(to, camera);
        }
    }

    pub fn remove(&mut self, at: usize) {
        self.cameras.remove(at);
        self.playing = None;
    }

    pub fn can_play(&self) -> bool {
        self.cameras.len() >= 2
    }

    pub fn is_playing(&self) -> bool {
        self.playing.is_some()
    }

    pub fn play_or_stop(&mut self) {
        self.playing = (self.playing.is_none() && self.can_play()).then_some(0.0);
    }

    pub fn stop(&mut self) {
        self.playing = None;
    }

    /// The camera of the preview `seconds` later; `None` once it is over.
    pub fn advance(&mut self, seconds: f64) -> Option<Camera> {
        let now = self.playing? + seconds;
        let share = now / self.seconds;
        self.playing = (share < 1.0).then_some(now);
        Some(self.path().ok()?.at(share.min(1.0)))
    }

    fn path(&self) -> Result<CameraPath, PathError> {
        CameraPath::new(self.cameras.clone(), false)
    }

    /// `info` is that of the scene.
    pub fn save(&self, path: &Path, info: &SceneInfo) -> Result<(), PathError> {
        self.path()?.save(path, info)
    }

    /// Takes the key cameras of a file for the scene of `info`.
    pub fn load(&mut self, path: &Path, info: &SceneInfo) -> Result<(), PathError> {
        self.cameras = CameraPath::load(path, info)?.keys().to_vec();
        self.playing = None;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::camera;

    fn editor(count: usize) -> PathEditor {
        let cameras = (0..count).map(|at| camera([at as f64, 3.0, 1.0], 100.0)).collect();
        PathEditor { cameras, ..PathEditor::default() }
    }

    fn order(editor: &PathEditor) -> Vec<f64> {
        editor.cameras.iter().map(|camera| camera.centre().x.round()).collect()
    }

    #[test]
    fn cameras_are_reordered_and_removed() {
        let mut editor = editor(4);
        editor.reorder(0, 2);
        assert_eq!(order(&editor), [1.0, 2.0, 0.0, 3.0]);
        editor.reorder(3, 0);
        assert_eq!(order(&editor), [3.0, 1.0, 2.0, 0.0]);
        editor.reorder(9, 0);
        editor.remove(1);
        assert_eq!(order(&editor), [3.0, 2.0, 0.0]);
    }

    #[test]
    fn the_preview_goes_from_the_first_to_the_last() {
        let mut editor = editor(3);
        editor.seconds = 1.0;
        assert_eq!(editor.advance(0.1), None);
        editor.play_or_stop();
        let first = editor.advance(1e-9).unwrap();
        assert!((first.centre() - editor.cameras[0].centre()).length() < 1e-6);
        assert!(editor.is_playing());
        let last = editor.advance(5.0).unwrap();
        assert!((last.centre() - editor.cameras[2].centre()).length() < 1e-9);
        assert!(!editor.is_playing() && editor.advance(0.1).is_none());
        let mut short = self::editor(1);
        short.play_or_stop();
        assert!(!short.is_playing());
    }

    #[test]
    fn paths_are_saved_and_loaded() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("path.json");
        let saved = editor(3);
        let info = SceneInfo::default();
        saved.save(&file, &info).unwrap();
        let mut loaded = PathEditor::default();
        loaded.load(&file, &info).unwrap();
        assert_eq!(order(&loaded), order(&saved));
        assert!(loaded.load(&folder.path().join("absent.json"), &info).is_err());
        assert_eq!(loaded.cameras.len(), 3, "the old path stays");
        assert!(PathEditor::default().save(&file, &info).is_err());
    }
}
