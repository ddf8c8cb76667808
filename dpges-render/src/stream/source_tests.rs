//! Ranges of files from a small web server.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};

use dpges_core::scene::SceneInfo;
use dpges_core::scene::lod::{CAMERAS, Index};

use super::fixtures::{filled, forest, write};
use super::{Levels, Source};
use crate::fixtures::camera;
use crate::path::CameraPath;

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Good,
    IgnoresRanges,
    BreaksOff,
    OtherRange,
    Busy,
}

/// Serves `folder` on a port of this machine for as long as the test runs; returns the address.
fn serve(folder: &Path, kind: Kind) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/scenes/room", listener.local_addr().unwrap());
    let folder = folder.to_owned();
    std::thread::spawn(move || listener.incoming().for_each(|stream| answer(stream.unwrap(), &folder, kind)));
    address
}

fn answer(mut stream: TcpStream, folder: &Path, kind: Kind) {
    let lines = BufReader::new(stream.try_clone().unwrap()).lines().map_while(Result::ok);
    let lines: Vec<String> = lines.take_while(|line| !line.is_empty()).collect();
    let name = lines[0].split(' ').nth(1).unwrap().strip_prefix("/scenes/room/").unwrap_or_default();
    let Ok(bytes) = fs::read(folder.join(name)) else {
        return stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n").unwrap();
    };
    let range = lines.iter().find_map(|line| line.to_lowercase().strip_prefix("range: bytes=").map(str::to_owned));
    let (mut head, body) = match range {
        Some(_) if kind == Kind::Busy => ("503 Service Unavailable\r\n".to_owned(), &bytes[..0]),
        Some(range) if kind != Kind::IgnoresRanges => {
            let (first, last) = range.split_once('-').unwrap();
            let first = first.parse::<usize>().unwrap() + usize::from(kind == Kind::OtherRange);
            let last = last.parse::<usize>().unwrap();
            if last >= bytes.len() {
                ("416 Range Not Satisfiable\r\n".to_owned(), &bytes[..0])
            } else {
                let sent = format!("206 Partial Content\r\nContent-Range: bytes {first}-{last}/{}\r\n", bytes.len());
                (sent, &bytes[first..=last])
            }
        }
        _ => ("200 OK\r\n".to_owned(), &bytes[..]),
    };
    head = format!("HTTP/1.1 {head}Content-Length: {}\r\nConnection: close\r\n\r\n", body.len());
    stream.write_all(head.as_bytes()).unwrap();
    let end = if kind == Kind::BreaksOff && body.len() > 100 { body.len() / 2 } else { body.len() };
    // the client may have gone
    let _ = stream.write_all(&body[..end]);
}

#[test]
fn parts_come_by_ranges_of_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let index = write(folder.path(), forest(1, 1), |index, cell| filled(index, cell, [5, 50 + cell]));
    let address = serve(folder.path(), Kind::Good);
    for place in [address.clone(), format!("{address}/"), format!("{address}/index.json")] {
        let web = Source::new(&PathBuf::from(&place)).unwrap();
        let found = web.index().unwrap();
        assert_eq!(found.place, Path::new(&address));
        assert_eq!(Index { place: PathBuf::new(), ..found }, index, "{place}");
        let local = Source::new(folder.path()).unwrap();
        for part in index.parts() {
            assert_eq!(web.read(part).unwrap(), local.read(part).unwrap());
        }
    }
    assert_eq!(Levels::open(address.as_ref(), 1000).unwrap().scene().counts(), [10, 103]);
    let cameras = |place: &Path| Levels::open(place, 1000).unwrap().cameras().to_vec();
    assert!(cameras(address.as_ref()).is_empty(), "there is no such file");
    let kept = [camera([4.0, 0.0, 1.0], 50.0), camera([0.0, 4.0, 1.5], 60.0)];
    CameraPath::new(kept.to_vec(), false).unwrap().save(&folder.path().join(CAMERAS), &SceneInfo::default()).unwrap();
    for place in [folder.path(), address.as_ref()] {
        let found = cameras(place);
        assert_eq!(found.iter().map(|camera| camera.fx).collect::<Vec<_>>(), kept.map(|camera| camera.fx));
    }
    fs::write(folder.path().join(CAMERAS), "[]").unwrap();
    assert!([folder.path(), address.as_ref()].into_iter().all(|place| cameras(place).is_empty()));
    fs::write(folder.path().join(CAMERAS), "[{\"id\": 0}]").unwrap();
    for place in [folder.path(), address.as_ref()] {
        let error = Levels::open(place, 1000).unwrap_err().to_string();
        assert!(error.contains("cameras.json") && error.contains("missing field"), "{error}");
    }
}

#[test]
fn servers_that_do_not_serve_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let mut index = write(folder.path(), forest(1, 1), |index, cell| filled(index, cell, [5, 50 + cell]));
    let error = |kind: Kind| {
        let source = Source::new(serve(folder.path(), kind).as_ref()).unwrap();
        source.read(&index.cells[1].part).unwrap_err().to_string()
    };
    for (kind, told) in [
        (Kind::IgnoresRanges, "ignores ranges"),
        (Kind::BreaksOff, "broke off"),
        (Kind::OtherRange, "the server sent `bytes"),
        (Kind::Busy, "503"),
    ] {
        let error = error(kind);
        assert!(error.contains(told) && error.contains("/scenes/room/cells.pack"), "{error}");
    }
    // the sky is the whole of its file
    let whole = Source::new(serve(folder.path(), Kind::IgnoresRanges).as_ref()).unwrap();
    assert!(whole.read(index.sky.as_ref().unwrap()).is_ok());
    let good = Source::new(serve(folder.path(), Kind::Good).as_ref()).unwrap();
    index.cells[1].part.bytes += 100_000;
    assert!(good.read(&index.cells[1].part).unwrap_err().to_string().contains("ends before byte"));
    index.cells[1].part.file = "other.pack".to_owned();
    assert!(good.read(&index.cells[1].part).unwrap_err().to_string().contains("404"));
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let nobody = Source::new(format!("http://127.0.0.1:{port}/").as_ref()).unwrap();
    assert!(nobody.index().unwrap_err().to_string().contains("cannot be reached"));
}
