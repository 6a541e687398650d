//! What a network made elsewhere does not say itself: a TOML file of the same stem beside it.

use std::{fs, path::Path};

use serde::Deserialize;

use super::ModelError;
use lapwing_core::perception::Preprocess;

/// The file beside a TorchScript or ONNX model:
///
/// ```
/// # use lapwing_learn::models::SideFile;
/// # let side: SideFile = toml::from_str(r#"
/// outputs = ["steering"]
///
/// [preprocess]
/// crop = { top = 60, bottom = 135 }
/// resize = { height = 66, width = 200, filter = "cv2-area" }
/// colour = "cv2-yuv"
/// scale = "none"
/// layout = "nhwc"
/// # "#)?;
/// # assert_eq!(side.preprocess.tensor_shape(), [1, 66, 200, 3]);
/// # Ok::<(), toml::de::Error>(())
/// ```
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SideFile {
    /// What each number of an answer is, the steering first.
    pub outputs: Vec<String>,
    /// What is done to a picture.
    pub preprocess: Preprocess,
}

impl SideFile {
    /// Reads the `.toml` of the same stem as `model`.
    ///
    /// # Errors
    /// [`ModelError::NoSideFile`], [`ModelError::SideFile`].
    pub fn beside(model: &Path) -> Result<Self, ModelError> {
        let side = model.with_extension("toml");
        let missing = |source| ModelError::NoSideFile { model: model.to_owned(), side: side.clone(), source };
        Self::parsed(&fs::read_to_string(&side).map_err(missing)?, &side)
    }

    /// Reads this file.
    ///
    /// # Errors
    /// [`ModelError::Read`], [`ModelError::SideFile`].
    pub fn read(path: &Path) -> Result<Self, ModelError> {
        let unread = |source| ModelError::Read { path: path.to_owned(), source };
        Self::parsed(&fs::read_to_string(path).map_err(unread)?, path)
    }

    fn parsed(text: &str, side: &Path) -> Result<Self, ModelError> {
        toml::from_str(text).map_err(|e| ModelError::SideFile { side: side.to_owned(), why: e.to_string() })
    }
}
