//! Import circles inside a crate: files that import each other can only be read, tested and moved together. An import
//! counts for the file that defines the item, whatever re-exports it passes. Circles between crates do not compile.

mod source;

use std::collections::{BTreeMap, BTreeSet};

use super::Finding;
use crate::metadata::Workspace;
use crate::tree::Tree;
use source::Source;

/// Maximum files of a circle: a type, its builder and a third part of the same idea.
const FILES_MAX: usize = 3;
/// Maximum re-exports on the way to a definition; more are a circle of their own.
const EXPORTS_MAX: usize = 12;

type Path<'t> = Vec<&'t str>;

/// The names that one file uses of others.
type Edges<'t> = BTreeMap<Path<'t>, BTreeSet<String>>;

pub(super) fn check(workspace: &Workspace, tree: &Tree) -> Vec<Finding> {
    let packages = workspace.packages.iter();
    packages
        .flat_map(|package| check_crate(&format!("{}/src/", package.dir), tree))
        .collect()
}

fn check_crate(folder: &str, tree: &Tree) -> Vec<Finding> {
    let modules = Modules::of(folder, tree);
    let edges: BTreeMap<_, _> = modules
        .all
        .keys()
        .map(|path| (path.clone(), modules.edges(path)))
        .collect();
    let circles = circles(&edges);
    let circles = circles.iter().filter(|circle| circle.len() > FILES_MAX);
    circles
        .map(|circle| {
            let name = |path: &Path<'_>| &modules.all[path].0[folder.len()..];
            let mut lines = Vec::new();
            for from in circle {
                for (to, names) in edges[from].iter().filter(|(to, _)| circle.contains(*to)) {
                    let names: Vec<_> = names.iter().map(String::as_str).collect();
                    lines.push(format!(
                        "{} -> {} ({})",
                        name(from),
                        name(to),
                        names.join(", ")
                    ));
                }
            }
            let (count, lines) = (circle.len(), lines.join("; "));
            let cause =
                format!("{count} files import each other, at most {FILES_MAX} may: {lines}");
            let remedy = "move what several of them use to a file that imports none of them";
            let first = circle.first().map_or(folder, |path| modules.all[path].0);
            Finding::new(first, 1, cause, remedy)
        })
        .collect()
}

/// The modules of a crate that have a file, with its path; without tests.
struct Modules<'t> {
    all: BTreeMap<Path<'t>, (&'t str, Source<'t>)>,
}

impl<'t> Modules<'t> {
    fn of(folder: &str, tree: &'t Tree) -> Self {
        let mut all = BTreeMap::new();
        for file in tree.rust_files() {
            let Some(inner) = file.path.strip_prefix(folder) else {
                continue;
            };
            let mut path: Path<'_> = inner.trim_end_matches(".rs").split('/').collect();
            let is_folder = matches!(path.last(), Some(&("lib" | "main" | "mod")));
            path.truncate(path.len() - usize::from(is_folder));
            let module = || (file.path.as_str(), Source::of(&file.text));
            all.entry(path).or_insert_with(module);
        }
        let tests: Vec<Path<'_>> = all
            .iter()
            .flat_map(|(path, (_, source))| {
                let names = source.tests.iter();
                names.map(|name| [path.as_slice(), &[*name]].concat())
            })
            .collect();
        all.retain(|path, _| !tests.iter().any(|test| path.starts_with(test)));
        Self { all }
    }

    /// The other files that the file of module `from` uses.
    fn edges(&self, from: &Path<'t>) -> Edges<'t> {
        let source = &self.all[from].1;
        let mut edges = Edges::new();
        let mut add = |path: Path<'t>, name: String| {
            let to = self.definition(path, 0);
            if let Some(to) = to.filter(|to| to != from) {
                edges.entry(to).or_default().insert(name);
            }
        };
        for import in &source.imports {
            let Some(path) = self.absolute(from, &import.path) else {
                continue;
            };
            if let [module @ .., "*"] = path.as_slice() {
                let module = self.all.get(module);
                let defined = module.map(|(_, source)| &source.defined);
                for name in defined.into_iter().flatten() {
                    if source.names.contains(name) {
                        add(
                            [&path[..path.len() - 1], &[*name]].concat(),
                            (*name).to_owned(),
                        );
                    }
                }
            } else if !self.all.contains_key(&path)
                && (!import.public || source.names.contains(import.alias))
            {
                add(path, import.alias.to_owned());
            }
        }
        for path in &source.paths {
            let absolute = self.absolute(from, path).or_else(|| {
                let import = source.imports.iter().find(|it| it.alias == path[0])?;
                let module = self.absolute(from, &import.path)?;
                let is_module = self.all.contains_key(&module);
                is_module.then(|| [module.as_slice(), &path[1..]].concat())
            });
            if let Some(absolute) = absolute.filter(|it| !self.all.contains_key(it)) {
                add(absolute, path.join("::"));
            }
        }
        edges
    }

    /// The path from the root of the crate; `None` if it leads to another crate.
    fn absolute(&self, module: &[&'t str], path: &[&'t str]) -> Option<Path<'t>> {
        let (first, rest) = path.split_first()?;
        match *first {
            "crate" => Some(rest.to_vec()),
            "self" => Some([module, rest].concat()),
            "super" => {
                let (_, parent) = module.split_last()?;
                match rest.first() {
                    Some(&"super") => self.absolute(parent, rest),
                    _ => Some([parent, rest].concat()),
                }
            }
            _ => {
                let inner = [module, path].concat();
                let is_own = self.all.contains_key(&inner[..=module.len()]);
                is_own.then_some(inner)
            }
        }
    }

    /// The module whose file defines the item at `path`, behind re-exports.
    fn definition(&self, path: Path<'t>, exports: usize) -> Option<Path<'t>> {
        let inside = (0..=path.len()).rev();
        let (module, rest) = inside
            .map(|len| path.split_at(len))
            .find(|(module, _)| self.all.contains_key(*module))?;
        let source = &self.all[module].1;
        let Some(name) = rest.first() else {
            return Some(module.to_vec());
        };
        if source.defined.contains(name) || exports == EXPORTS_MAX {
            return Some(module.to_vec());
        }
        let named = source.imports.iter().find(|import| import.alias == *name);
        if let Some(import) = named {
            let next = self.absolute(module, &import.path)?;
            return self.definition([&next, &rest[1..]].concat(), exports + 1);
        }
        let globs = source.imports.iter().filter(|import| import.alias == "*");
        let from_glob = globs.filter_map(|import| {
            let next = self.absolute(module, &import.path[..import.path.len() - 1])?;
            let found = self.definition([&next, rest].concat(), exports + 1)?;
            self.all[&found].1.defined.contains(name).then_some(found)
        });
        from_glob
            .into_iter()
            .next()
            .or_else(|| Some(module.to_vec()))
    }
}

/// The sets of files that reach each other, each once.
fn circles<'t>(edges: &BTreeMap<Path<'t>, Edges<'t>>) -> BTreeSet<BTreeSet<Path<'t>>> {
    let reached: BTreeMap<_, _> = edges
        .keys()
        .map(|path| (path, reach(path, edges)))
        .collect();
    let circle = |path: &Path<'t>| {
        let others = reached[path].iter();
        let others = others.filter(|other| reached[*other].contains(path));
        others.cloned().collect::<BTreeSet<_>>()
    };
    edges.keys().map(circle).collect()
}

/// The files that a file uses, directly or through others.
fn reach<'t>(from: &Path<'t>, edges: &BTreeMap<Path<'t>, Edges<'t>>) -> BTreeSet<Path<'t>> {
    let (mut reached, mut open) = (BTreeSet::new(), vec![from]);
    while let Some(path) = open.pop() {
        for next in edges[path].keys() {
            if reached.insert(next.clone()) {
                open.push(next);
            }
        }
    }
    reached
}

#[cfg(test)]
mod tests {
    use super::super::tests::{causes, package, workspace};
    use super::*;

    fn found(files: &[(&str, &str)]) -> Vec<String> {
        let tree = Tree::of(files);
        causes(&check(&workspace(vec![package("takt-a")]), &tree))
    }

    const ROOT: (&str, &str) = (
        "a/src/lib.rs",
        "mod b;\nmod c;\nmod d;\nmod e;\npub use b::B;",
    );
    const B: (&str, &str) = ("a/src/b.rs", "use crate::c::C;\npub struct B(C);");
    const C: (&str, &str) = ("a/src/c.rs", "pub struct C(crate::d::D);");
    const D: (&str, &str) = ("a/src/d.rs", "use super::e;\npub struct D(e::E);");

    #[test]
    fn circle_of_four_files_names_its_edges() {
        let e = ("a/src/e.rs", "use crate::B;\npub struct E(Box<B>);");
        let expected = "a/src/b.rs:1 4 files import each other, at most 3 may: b.rs -> c.rs (C); \
                        c.rs -> d.rs (crate::d::D); d.rs -> e.rs (e::E); e.rs -> b.rs (B)";
        assert_eq!(found(&[ROOT, B, C, D, e]), [expected]);
    }

    #[test]
    fn circle_of_three_files_is_allowed() {
        let d = ("a/src/d.rs", "pub struct D(Box<crate::B>);");
        assert!(found(&[ROOT, B, C, d]).is_empty());
    }

    #[test]
    fn circle_through_globs_and_parents_is_found() {
        let root = ("a/src/lib.rs", "mod b;");
        let b = (
            "a/src/b/mod.rs",
            "mod c;\nmod d;\nmod e;\nfn f() { c::g() }\nuse c::*;",
        );
        let c = ("a/src/b/c.rs", "use super::d::*;\npub fn g() { h() }");
        let d = ("a/src/b/d.rs", "pub fn h() { super::e::i() }");
        let e = ("a/src/b/e.rs", "pub fn i() { super::f() }");
        assert_eq!(found(&[root, b, c, d, e]).len(), 1);
    }

    #[test]
    fn circle_of_tests_and_visibility_is_ignored() {
        let e = (
            "a/src/e.rs",
            "pub(in crate::b) struct E;\n#[cfg(test)]\nmod tests { use crate::B; }\n#[cfg(test)]\nmod f;",
        );
        let f = ("a/src/e/f.rs", "use crate::B;");
        assert!(found(&[ROOT, B, C, D, e, f]).is_empty());
    }

    #[test]
    fn circle_of_declarations_is_none() {
        let b = ("a/src/b.rs", "pub struct B(super::e::E);");
        let e = ("a/src/e.rs", "pub struct E;");
        assert!(found(&[ROOT, b, C, D, e]).is_empty());
    }
}
