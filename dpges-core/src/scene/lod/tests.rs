use std::fs;

use super::*;
use crate::scene::{ColourModel, EnvironmentData, Quality, SceneData};
use crate::testing::scenes::numbered;

fn scene(surfels: usize, gaussians: usize) -> SceneData {
    numbered(ColourModel::default(), [surfels, gaussians], |attribute, _| attribute.neutral[0])
}

fn part(file: &str, offset: usize, bytes: &[u8]) -> Part {
    Part { file: file.to_owned(), offset: offset as u64, bytes: bytes.len() as u64 }
}

/// A root with one surfel and two children, in one pack, and a sky; the bytes of all.
fn written(folder: &std::path::Path) -> (Index, Vec<u8>) {
    let mut index = Index::new(scene(0, 0).info);
    let mut pack = Vec::new();
    let links = [(None, vec![1, 2], 1), (Some(0), vec![], 0), (Some(0), vec![], 0)];
    for ((parent, children, level), [surfels, gaussians]) in links.into_iter().zip([[1, 2], [1, 0], [0, 4]]) {
        let bytes = scene(surfels, gaussians).to_compressed(&Quality::HIGH, "cell".as_ref()).unwrap();
        let part = part("cells.pack", pack.len(), &bytes);
        pack.extend(bytes);
        let (min, max, size) = ([-3.0; 3], [3.0; 3], 1.0);
        index.cells.push(Cell { level, min, max, parent, children, part, surfels, gaussians, size });
    }
    let sky = SceneData { environment: Some(EnvironmentData::neutral(1)), ..scene(0, 0) };
    let bytes = sky.to_compressed(&Quality::HIGH, "sky".as_ref()).unwrap();
    index.sky = Some(part("base.safetensors", 0, &bytes));
    fs::write(folder.join("base.safetensors"), bytes).unwrap();
    fs::write(folder.join("cells.pack"), &pack).unwrap();
    fs::write(folder.join(INDEX), serde_json::to_vec(&index).unwrap()).unwrap();
    (index, pack)
}

#[test]
fn cells_and_the_sky_come_back_from_a_folder_and_from_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let (index, pack) = written(folder.path());
    let found = Index::open(folder.path()).unwrap();
    assert_eq!(found, Index { place: folder.path().to_owned(), ..index });
    assert_eq!((found.roots().collect::<Vec<_>>(), found.level_count()), (vec![0], 2));
    assert_eq!(found.level(0).collect::<Vec<_>>(), [1, 2]);
    for (at, cell) in found.cells.iter().enumerate() {
        let bytes = Index::read_part(folder.path(), &cell.part).unwrap();
        assert_eq!(bytes, pack[cell.part.offset as usize..][..bytes.len()]);
        let scene = found.cell(at, &bytes).unwrap();
        assert_eq!((scene.surfels.len(), scene.gaussians.len()), (cell.surfels, cell.gaussians));
    }
    let sky = found.sky.as_ref().unwrap();
    let scene = found.sky(sky, &Index::read_part(folder.path(), sky).unwrap()).unwrap();
    assert_eq!(scene.environment.unwrap().len(), 4);
}

#[test]
fn what_cannot_be_is_told_with_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let (index, pack) = written(folder.path());
    let error = |change: &dyn Fn(&mut Index)| {
        let mut index = index.clone();
        change(&mut index);
        Index::from_bytes(&serde_json::to_vec(&index).unwrap(), "there/index.json").unwrap_err().to_string()
    };
    for (found, part) in [
        (error(&|index| index.version = 2), "`version` is 2, expected 1: a newer"),
        (error(&|index| index.format = "other".into()), "`format` is `other`"),
        (error(&|index| index.cells[1].part.file = "../secret".into()), "cell 1 is in the file \"../secret\""),
        (error(&|index| index.cells[1].part.bytes = 0), "cell 1 has 0 bytes"),
        (error(&|index| index.cells[1].part.offset = u64::MAX), "cell 1 has"),
        (error(&|index| index.cells[2].min[1] = 9.0), "cell 2 has a box"),
        (error(&|index| index.cells[0].children.push(7)), "cell 0 has the child 7, and there are 3 cells"),
        (error(&|index| index.cells[0].children.clear()), "cell 0 of level 1 has 0 children"),
        (error(&|index| index.cells[1].level = 1), "cell 0 of level 1 has the child 1, which is of level 1"),
        (error(&|index| index.cells[1].parent = None), "cell 0 of level 1 has the child 1"),
        (error(&|index| index.cells[0].children = vec![1]), "cell 2 names Some(0) as its parent, and is a child of 0"),
        (
            error(&|index| index.cells[0].children = vec![1, 1, 2]),
            "cell 1 names Some(0) as its parent, and is a child of 2",
        ),
    ] {
        assert!(found.contains(part) && found.contains("there/index.json"), "{found}");
    }
    let broken = Index::from_bytes(&fs::read(folder.path().join(INDEX)).unwrap()[..90], "index.json").unwrap_err();
    assert!(broken.to_string().contains("export it again"), "{broken}");

    // cells that are damaged, or of another scene
    let cell = |at: usize| &pack[index.cells[at].part.offset as usize..][..index.cells[at].part.bytes as usize];
    let mut flipped = cell(2).to_vec();
    *flipped.last_mut().unwrap() ^= 1;
    let torn = Index::open(folder.path()).unwrap().cell(2, &flipped).unwrap_err().to_string();
    assert!(
        torn.contains(&*folder.path().join("cells.pack").to_string_lossy())
            && torn.contains("cell 2")
            && torn.contains("again"),
        "{torn}"
    );
    let other = index.cell(2, cell(1)).unwrap_err().to_string();
    assert!(other.contains("1 surfels and 0 Gaussians, the index says 0 surfels and 4 Gaussians"), "{other}");
    let mut changed = index.clone();
    changed.settings.layer_count = 2;
    assert!(changed.cell(1, cell(1)).unwrap_err().to_string().contains("settings"));

    // packs that are missing or cut off
    fs::write(folder.path().join("cells.pack"), &pack[..pack.len() - 1]).unwrap();
    let short = Index::open(folder.path()).unwrap_err().to_string();
    assert!(short.contains("cells.pack") && short.contains("the index expects"), "{short}");
    assert!(Index::read_part(folder.path(), &index.cells[2].part).unwrap_err().to_string().contains("cells.pack"));
    fs::remove_file(folder.path().join("cells.pack")).unwrap();
    assert!(Index::open(folder.path()).unwrap_err().to_string().contains("cells.pack"));
}
