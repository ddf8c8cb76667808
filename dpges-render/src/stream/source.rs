//! Where the files of a scene in levels of detail are: in a folder, or on a web server.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
#[cfg(feature = "http")]
use std::time::Duration;

use dpges_core::camera::Camera;
use dpges_core::scene::lod::{CAMERAS, INDEX, Index, Part};

use super::StreamError;
use crate::path::CameraPath;

/// Longest wait for a server to answer a request, and for all of an answer.
#[cfg(feature = "http")]
const PATIENCE: [Duration; 2] = [Duration::from_secs(20), Duration::from_secs(300)];
/// Largest index that is read, bytes.
#[cfg(feature = "http")]
const LARGEST_INDEX: u64 = 1 << 28;

/// A folder, or the address of one.
#[derive(Clone, Debug)]
pub enum Source {
    Folder(PathBuf),
    #[cfg(feature = "http")]
    Web {
        client: ureq::Agent,
        /// Ends with `/`.
        base: String,
    },
}

/// Whether `place` is a scene in levels of detail: a folder with an index, such an index, or an address of the web.
pub fn is_lod(place: &Path) -> bool {
    is_address(place) || place.ends_with(INDEX) && place.is_file() || place.join(INDEX).is_file()
}

/// Whether `place` is an address of the web.
pub fn is_address(place: &Path) -> bool {
    place.to_str().is_some_and(|text| text.starts_with("http://") || text.starts_with("https://"))
}

impl Source {
    /// The folder or address `place`, with or without the name of the index.
    ///
    /// # Errors
    /// [`StreamError::Load`] for an address where the program has no HTTP.
    pub fn new(place: &Path) -> Result<Self, StreamError> {
        if is_address(place) {
            return Self::web(&place.to_string_lossy());
        }
        let folder = if place.ends_with(INDEX) { place.parent().unwrap_or(place) } else { place };
        Ok(Self::Folder(folder.to_owned()))
    }

    #[cfg(not(feature = "http"))]
    fn web(address: &str) -> Result<Self, StreamError> {
        let reason = "this program reads no addresses: it was built without the feature `http`".to_owned();
        Err(StreamError::Load { place: address.to_owned(), reason })
    }

    #[cfg(feature = "http")]
    fn web(address: &str) -> Result<Self, StreamError> {
        let config = ureq::Agent::config_builder()
            .timeout_recv_response(Some(PATIENCE[0]))
            .timeout_connect(Some(PATIENCE[0]))
            .timeout_global(Some(PATIENCE[1]))
            .http_status_as_error(false)
            .user_agent("dpges")
            .build();
        let base = address.strip_suffix(INDEX).unwrap_or(address).trim_end_matches('/');
        Ok(Self::Web { client: config.into(), base: format!("{base}/") })
    }

    /// # Errors
    /// [`StreamError::Scene`] for a folder or an index that is wrong, [`StreamError::Load`] for an address that cannot be read.
    pub fn index(&self) -> Result<Index, StreamError> {
        match self {
            Self::Folder(folder) => Ok(Index::open(folder)?),
            #[cfg(feature = "http")]
            Self::Web { client, base } => {
                let place = format!("{base}{INDEX}");
                let bytes = web::whole(client, &place, LARGEST_INDEX)
                    .map_err(|reason| StreamError::Load { place: place.clone(), reason })?;
                Ok(Index::from_bytes(&bytes, &place)?)
            }
        }
    }

    /// The cameras beside the index, those without a near plane with `near`; none if there is no such file: a scene can be
    /// shown without.
    ///
    /// # Errors
    /// [`StreamError::Load`] for a file that cannot be read or lists no cameras.
    pub fn cameras(&self, near: f64) -> Result<Vec<Camera>, StreamError> {
        let (place, text) = match self {
            Self::Folder(folder) => {
                let path = folder.join(CAMERAS);
                let text = std::fs::read_to_string(&path);
                if text.as_ref().is_err_and(|error| error.kind() == ErrorKind::NotFound) {
                    return Ok(Vec::new());
                }
                (path.display().to_string(), text.map_err(|error| error.to_string()))
            }
            #[cfg(feature = "http")]
            Self::Web { client, base } => {
                let place = format!("{base}{CAMERAS}");
                let bytes = web::whole(client, &place, LARGEST_INDEX).ok();
                // some servers answer with a page where there is no file
                let text = bytes.and_then(|bytes| String::from_utf8(bytes).ok()).filter(|text| text.starts_with('['));
                let Some(text) = text else { return Ok(Vec::new()) };
                (place, Ok(text))
            }
        };
        let cameras = |text: String| {
            if text == "[]" { Ok(Vec::new()) } else { Ok(CameraPath::from_json(&text, near)?.keys().to_vec()) }
        };
        text.and_then(cameras).map_err(|reason| {
            let reason =
                format!("{reason}; expected a list of cameras as in the cameras.json of 3DGS, or no such file");
            StreamError::Load { place, reason }
        })
    }

    /// # Errors
    /// As [`index`](Self::index).
    pub fn read(&self, part: &Part) -> Result<Vec<u8>, StreamError> {
        match self {
            Self::Folder(folder) => Ok(Index::read_part(folder, part)?),
            #[cfg(feature = "http")]
            Self::Web { client, base } => {
                let place = format!("{base}{}", part.file);
                web::range(client, &place, part).map_err(|reason| StreamError::Load { place, reason })
            }
        }
    }
}

#[cfg(feature = "http")]
mod web {
    use dpges_core::scene::lod::Part;
    use ureq::Agent;
    use ureq::http::header::{CONTENT_RANGE, RANGE};
    use ureq::http::{Response, StatusCode};

    /// All of a file.
    pub fn whole(client: &Agent, address: &str, most: u64) -> Result<Vec<u8>, String> {
        let answer = client.get(address).call().map_err(unreachable)?;
        match answer.status() {
            StatusCode::OK => body(answer, most),
            status => Err(refused(status)),
        }
    }

    /// The bytes of `part` of a file. A server that ignores ranges would send the whole file for each cell: it is refused,
    /// unless the part is the whole file.
    pub fn range(client: &Agent, address: &str, part: &Part) -> Result<Vec<u8>, String> {
        let last = part.offset + part.bytes - 1;
        let asked = format!("bytes={}-{last}", part.offset);
        let answer = client.get(address).header(RANGE, asked).call().map_err(unreachable)?;
        let sent = |answer: &Response<ureq::Body>| {
            let sent = answer.headers().get(CONTENT_RANGE).and_then(|value| value.to_str().ok().map(str::to_owned));
            sent.unwrap_or_default()
        };
        match answer.status() {
            StatusCode::PARTIAL_CONTENT => {
                let (expected, sent) = (format!("bytes {}-{last}/", part.offset), sent(&answer));
                if !sent.starts_with(&expected) {
                    return Err(format!("the server sent `{sent}`, expected `{expected}…`"));
                }
            }
            StatusCode::OK if part.offset == 0 && answer.body().content_length() == Some(part.bytes) => {}
            StatusCode::OK => {
                let reason = "the server sends whole files and ignores ranges of bytes: serve the folder with one that \
                              knows them, such as nginx, Apache or Caddy";
                return Err(reason.to_owned());
            }
            StatusCode::RANGE_NOT_SATISFIABLE => {
                return Err(format!("it ends before byte {last}: copy or export the scene again"));
            }
            status => return Err(refused(status)),
        }
        let bytes = body(answer, part.bytes)?;
        if bytes.len() as u64 == part.bytes {
            Ok(bytes)
        } else {
            Err(format!("the answer ended after {} of {} bytes", bytes.len(), part.bytes))
        }
    }

    fn body(mut answer: Response<ureq::Body>, most: u64) -> Result<Vec<u8>, String> {
        let read = answer.body_mut().with_config().limit(most + 1).read_to_vec();
        read.map_err(|error| format!("the answer broke off: {error}"))
    }

    fn unreachable(error: ureq::Error) -> String {
        format!("cannot be reached ({error}): check the address, and whether the server runs")
    }

    fn refused(status: StatusCode) -> String {
        match status {
            StatusCode::NOT_FOUND => "is not there (404): check the address".to_owned(),
            status => format!("the server answered {status}"),
        }
    }
}
