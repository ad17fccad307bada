//! A host as a tree of paths with texts: this machine, or a tree saved from another one.
//!
//! Texts are cached, so that a saved host holds what its examination read. It never judges, and it writes only to files
//! that exist.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::path::{Path, PathBuf};

use super::cpus::Cpus;
use super::probe;

/// Facts that no file shows are read under this folder, which no real host has: probed on a live host, a file in a saved
/// tree.
pub(super) const FACTS: &str = "/takt-doctor/";

/// Bytes read of a file at most: `/proc/interrupts` of the largest machines fits.
const BYTES_MAX: u64 = 4 << 20;

/// Paths that exist and may not be read are listed here in a saved tree.
const DENIED: &str = "/takt-doctor/denied";

/// The entry at a path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Entry {
    Text(String),
    /// Names of a folder, sorted.
    Names(Vec<String>),
    /// Where a symbolic link leads.
    Link(String),
    /// It exists, and this user may not read it.
    Denied,
    Absent,
}

/// Where the paths are.
#[derive(Debug)]
enum Source {
    Live,
    Tree(PathBuf),
    /// Only in the cache.
    #[cfg(test)]
    Known,
}

/// Interfaces and service to examine.
#[derive(Clone, Debug, Default)]
pub(super) struct Subject {
    /// Interfaces to examine; empty for all that could carry a field bus.
    pub(super) interfaces: Vec<String>,
    /// The unit of the service; `None` for `takt.service` if there is one.
    pub(super) service: Option<String>,
}

/// A host that can be read. All paths begin with a slash, whatever the root is; each is used as one thing, file, folder
/// or link.
#[derive(Debug)]
pub(super) struct Host {
    source: Source,
    pub(super) subject: Subject,
    seen: RefCell<BTreeMap<String, Entry>>,
}

impl Host {
    /// This machine.
    pub(super) fn live(subject: Subject) -> Self {
        Self::new(Source::Live, subject)
    }

    /// A tree of files; symbolic links in it are not followed out of it.
    pub(super) fn tree(root: &Path, subject: Subject) -> io::Result<Self> {
        let host = Self::new(Source::Tree(root.canonicalize()?), subject);
        if let Some(denied) = host.text(DENIED) {
            let denied = denied.lines().map(|path| (path.to_owned(), Entry::Denied));
            host.seen.borrow_mut().extend(denied);
        }
        Ok(host)
    }

    /// A host of which all is known.
    #[cfg(test)]
    pub(super) fn known(entries: BTreeMap<String, Entry>) -> Self {
        let host = Self::new(Source::Known, Subject::default());
        host.seen.borrow_mut().extend(entries);
        host
    }

    fn new(source: Source, subject: Subject) -> Self {
        Self {
            source,
            subject,
            seen: RefCell::default(),
        }
    }

    pub(super) fn is_live(&self) -> bool {
        matches!(self.source, Source::Live)
    }

    /// The text of a file, `None` if it cannot be read.
    pub(super) fn text(&self, path: &str) -> Option<String> {
        match self.cached(path, |host| host.read(path)) {
            Entry::Text(text) => Some(text),
            Entry::Names(_) | Entry::Link(_) | Entry::Denied | Entry::Absent => None,
        }
    }

    /// The text without the white space around it.
    pub(super) fn value(&self, path: &str) -> Option<String> {
        self.text(path).map(|text| text.trim().to_owned())
    }

    /// The text as a number.
    pub(super) fn number(&self, path: &str) -> Option<i64> {
        self.text(path)?.trim().parse().ok()
    }

    /// The text as a list of processors.
    pub(super) fn cpus(&self, path: &str) -> Option<Cpus> {
        Cpus::from_list(&self.text(path)?)
    }

    /// The result of a probe; see [`probe::fact`] for the names.
    pub(super) fn fact(&self, name: &str) -> Option<String> {
        self.text(&format!("{FACTS}{name}"))
    }

    /// Whether a file exists that this user may not read.
    pub(super) fn is_denied(&self, path: &str) -> bool {
        self.cached(path, |host| host.read(path)) == Entry::Denied
    }

    /// Names in a folder, sorted; none if there is no such folder.
    pub(super) fn names(&self, path: &str) -> Vec<String> {
        match self.cached(path, |host| host.list(path)) {
            Entry::Names(names) => names,
            Entry::Text(_) | Entry::Link(_) | Entry::Denied | Entry::Absent => Vec::new(),
        }
    }

    /// The last part of where a symbolic link leads, such as the name of a driver.
    pub(super) fn link(&self, path: &str) -> Option<String> {
        match self.cached(path, |host| host.target(path)) {
            Entry::Link(target) => target.rsplit('/').next().map(str::to_owned),
            Entry::Text(_) | Entry::Names(_) | Entry::Denied | Entry::Absent => None,
        }
    }

    /// Replaces the text of a file that exists.
    pub(super) fn write(&self, path: &str, value: &str) -> io::Result<()> {
        let resolved = self.resolved(path).ok_or(io::ErrorKind::NotFound)?;
        let mut file = OpenOptions::new()
            .write(true)
            .truncate(true)
            .open(resolved)?;
        // One call: a setting of the kernel takes each write as one value.
        file.write_all(format!("{value}\n").as_bytes())?;
        self.seen.borrow_mut().remove(path);
        Ok(())
    }

    /// Path of a file of the doctor's own, below the same root.
    pub(super) fn own_file(&self, path: &str) -> PathBuf {
        match &self.source {
            Source::Tree(root) => root.join(path.trim_start_matches('/')),
            Source::Live => PathBuf::from(path),
            #[cfg(test)]
            Source::Known => PathBuf::from(path),
        }
    }

    /// Writes all entries read so far below `root`, at the paths it was read from.
    pub(super) fn save(&self, root: &Path) -> io::Result<usize> {
        let seen = self.seen.borrow();
        let mut denied = String::new();
        let mut saved = 0;
        for (path, entry) in seen.iter() {
            let to = root.join(path.trim_start_matches('/'));
            match entry {
                Entry::Text(text) => write_file(&to, text)?,
                Entry::Link(target) => make_link(&to, target)?,
                Entry::Names(_) => fs::create_dir_all(&to)?,
                Entry::Denied => denied += &format!("{path}\n"),
                Entry::Absent => continue,
            }
            saved += 1;
        }
        // Last: most names were read and exist by now. Of the others only the name counts; they become files, as some
        // archives lose empty folders.
        for (path, entry) in seen.iter() {
            if let Entry::Names(names) = entry {
                let folder = root.join(path.trim_start_matches('/'));
                let missing = names.iter().map(|name| folder.join(name));
                for name in missing.filter(|name| name.symlink_metadata().is_err()) {
                    File::create(name)?;
                }
            }
        }
        write_file(&root.join(DENIED.trim_start_matches('/')), &denied)?;
        Ok(saved)
    }

    fn cached(&self, path: &str, read: impl FnOnce(&Self) -> Entry) -> Entry {
        if let Some(entry) = self.seen.borrow().get(path) {
            return entry.clone();
        }
        let entry = read(self);
        self.seen
            .borrow_mut()
            .insert(path.to_owned(), entry.clone());
        entry
    }

    fn read(&self, path: &str) -> Entry {
        if self.is_live()
            && let Some(name) = path.strip_prefix(FACTS)
        {
            return probe::fact(name).map_or(Entry::Absent, Entry::Text);
        }
        let Some(resolved) = self.resolved(path) else {
            return Entry::Absent;
        };
        let mut bytes = Vec::new();
        let read =
            File::open(resolved).and_then(|file| file.take(BYTES_MAX).read_to_end(&mut bytes));
        match read {
            Ok(_) => Entry::Text(String::from_utf8_lossy(&bytes).into_owned()),
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => Entry::Denied,
            Err(_) => Entry::Absent,
        }
    }

    fn list(&self, path: &str) -> Entry {
        #[cfg(test)]
        if matches!(self.source, Source::Known) {
            return self.known_names(path);
        }
        let Some(folder) = self
            .resolved(path)
            .and_then(|resolved| fs::read_dir(resolved).ok())
        else {
            return Entry::Absent;
        };
        let names = folder.filter_map(|item| item.ok()?.file_name().into_string().ok());
        let mut names: Vec<String> = names.collect();
        names.sort();
        Entry::Names(names)
    }

    #[cfg(test)]
    fn known_names(&self, path: &str) -> Entry {
        let seen = self.seen.borrow();
        let below = seen.keys().filter_map(|known| {
            let rest = known.strip_prefix(path)?.strip_prefix('/')?;
            rest.split('/').next().map(str::to_owned)
        });
        let names: std::collections::BTreeSet<String> = below.collect();
        Entry::Names(names.into_iter().collect())
    }

    fn target(&self, path: &str) -> Entry {
        let below = self.unresolved(path);
        let parent = below
            .as_deref()
            .and_then(Path::parent)
            .and_then(|parent| self.inside(parent));
        let name = below.as_deref().and_then(Path::file_name);
        let (Some(parent), Some(name)) = (parent, name) else {
            return Entry::Absent;
        };
        fs::read_link(parent.join(name)).map_or(Entry::Absent, |target| {
            Entry::Link(target.to_string_lossy().into_owned())
        })
    }

    /// The file behind a path, resolved; `None` if it does not exist or lies outside the root.
    fn resolved(&self, path: &str) -> Option<PathBuf> {
        self.inside(&self.unresolved(path)?)
    }

    fn unresolved(&self, path: &str) -> Option<PathBuf> {
        match &self.source {
            Source::Live => Some(PathBuf::from(path)),
            Source::Tree(root) => Some(root.join(path.trim_start_matches('/'))),
            #[cfg(test)]
            Source::Known => None,
        }
    }

    fn inside(&self, path: &Path) -> Option<PathBuf> {
        match &self.source {
            Source::Live => Some(path.to_owned()),
            Source::Tree(root) => path.canonicalize().ok().filter(|p| p.starts_with(root)),
            #[cfg(test)]
            Source::Known => None,
        }
    }
}

fn write_file(to: &Path, text: &str) -> io::Result<()> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder)?;
    }
    fs::write(to, text)
}

fn make_link(to: &Path, target: &str) -> io::Result<()> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder)?;
    }
    std::os::unix::fs::symlink(target, to)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An empty folder of this test's own, removed at the end.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("takt-{name}-{}", std::process::id()));
            let _ = fs::remove_dir_all(&path);
            fs::create_dir_all(&path).unwrap();
            Self(path)
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn host_link_out_of_tree_is_not_followed() {
        let folder = Folder::new("doctor-outside");
        fs::write(folder.0.join("secret"), "outside").unwrap();
        let root = folder.0.join("tree");
        fs::create_dir_all(root.join("etc")).unwrap();
        make_link(&root.join("etc/link"), "../../secret").unwrap();
        let host = Host::tree(&root, Subject::default()).unwrap();
        assert_eq!(host.text("/etc/link"), None);
        assert_eq!(host.text("/../secret"), None);
        host.write("/etc/link", "overwritten").unwrap_err();
        assert_eq!(
            fs::read_to_string(folder.0.join("secret")).unwrap(),
            "outside"
        );
        let again = Host::tree(&root, Subject::default()).unwrap();
        assert_eq!(again.link("/etc/link").as_deref(), Some("secret"));
    }

    #[test]
    fn host_save_writes_what_was_read() {
        let folder = Folder::new("doctor-save");
        let files = [
            ("/proc/a", "1\n"),
            ("/sys/d/x/v", "2\n"),
            ("/sys/d/y/v", "3"),
        ];
        let files = files.map(|(path, text)| (path.to_owned(), Entry::Text(text.to_owned())));
        let host = Host::known(files.into_iter().collect());
        let denied = Entry::Denied;
        host.seen.borrow_mut().insert("/sys/secret".into(), denied);
        assert_eq!(host.names("/sys/d"), ["x", "y"]);
        host.save(&folder.0).unwrap();
        let again = Host::tree(&folder.0, Subject::default()).unwrap();
        assert_eq!(again.names("/sys/d"), ["x", "y"]);
        assert_eq!(again.number("/proc/a"), Some(1));
        assert_eq!(again.value("/sys/d/y/v").as_deref(), Some("3"));
        assert!(again.is_denied("/sys/secret") && !again.is_denied("/sys/none"));
    }
}
