//! Models of arms from URDF files: `model = "urdf:ur5e.urdf"` (of arms with a model of their maker `kinematics`), with `base_link` and `tip_link`, anywhere in a cell file. The
//! file is read here, so that drivers get the chain of joints itself and read no files.

use std::borrow::Cow;
use std::path::Path;

use takt_motion::kinematics::JointKind;
use takt_motion::urdf::{ArmModel, read_arm};
use takt_motion::{Model, URDF};
use toml::de::{DeTable, DeValue, Error};

use super::drivers::error_at;

/// The keys that have such a model.
const KEYS: [&str; 2] = ["model", "kinematics"];

/// Replaces the name of each URDF by the chain of its joints; relative paths are in `folder`.
pub(super) fn resolve(table: &mut DeTable<'_>, folder: &Path) -> Result<(), Error> {
    for key in KEYS {
        resolve_key(table, key, folder)?;
    }
    for (_, value) in table.iter_mut() {
        inner(value.get_mut(), folder)?;
    }
    Ok(())
}

fn resolve_key(table: &mut DeTable<'_>, key: &str, folder: &Path) -> Result<(), Error> {
    if let Some(model) = table.get(key)
        && let Some(path) = model
            .get_ref()
            .as_str()
            .and_then(|it| it.strip_prefix(URDF))
    {
        let path = folder.join(path);
        let span = model.span();
        let links = ["base_link", "tip_link"].map(|key| link(table, key));
        let [base, tip] = links;
        let (base, tip) = (base?, tip?);
        let arm = read_arm(&path, base.as_deref(), tip.as_deref());
        let arm = arm.map_err(|error| error.to_string());
        let arm = arm.and_then(|arm| turning(arm, &path));
        let arm = arm.map_err(|why| error_at(span, &why))?;
        for warning in &arm.warnings {
            let (file, line) = (path.display(), warning.line);
            tracing::warn!("{file}:{line}: {}\nhint: {}", warning.cause, warning.hint);
        }
        let text = Model::of_arm(arm).full_text().into_owned();
        if let Some(model) = table.get_mut(key) {
            *model.get_mut() = DeValue::String(Cow::Owned(text));
        }
    }
    Ok(())
}

fn inner(value: &mut DeValue<'_>, folder: &Path) -> Result<(), Error> {
    match value {
        DeValue::Table(table) => resolve(table, folder),
        DeValue::Array(items) => {
            let mut items = items.iter_mut();
            items.try_for_each(|item| inner(item.get_mut(), folder))
        }
        DeValue::String(_)
        | DeValue::Integer(_)
        | DeValue::Float(_)
        | DeValue::Boolean(_)
        | DeValue::Datetime(_) => Ok(()),
    }
}

/// Takes the name of a link out of the table of its arm.
fn link(table: &mut DeTable<'_>, key: &str) -> Result<Option<String>, Error> {
    let Some(value) = table.remove(key) else {
        return Ok(None);
    };
    match value.get_ref().as_str() {
        Some(link) => Ok(Some(link.to_owned())),
        None => {
            let why = format!("`{key}` must be the name of a link");
            Err(error_at(value.span(), &why))
        }
    }
}

/// The arm, if all its joints turn.
fn turning(arm: ArmModel, path: &Path) -> Result<ArmModel, String> {
    let mut joints = arm.joints.iter();
    match joints.find(|joint| joint.kind == JointKind::Prismatic) {
        None => Ok(arm),
        Some(joint) => Err(format!(
            "{}:{}: joint `{}` slides: arms of a cell have joints that turn, since limits, set-points and jogging count in \
             degrees and radians\nhint: name a base_link behind it, or a tip_link before it",
            path.display(),
            joint.line,
            joint.name
        )),
    }
}
