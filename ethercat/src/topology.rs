//! How slaves hang on each other: from which ports of each are open follows the tree, as frames pass ports in the
//! order 0, 3, 1, 2 (ETG.1000.4). Which cable is bad is not decided here.

/// The tree of a segment; slaves are numbered by their position in the ring.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Topology {
    ports: Vec<[bool; 4]>,
    /// The slave and the port that each hangs on.
    parents: Vec<Option<(usize, usize)>>,
}

impl Topology {
    /// From the open ports of the slaves, by position in the ring. A slave for which no port is left hangs on none.
    #[must_use]
    pub fn new(ports: &[[bool; 4]]) -> Self {
        let mut parents = Vec::with_capacity(ports.len());
        // Ports that frames are still to leave by, the nearest last.
        let mut free: Vec<(usize, usize)> = Vec::new();
        for (number, open) in ports.iter().enumerate() {
            parents.push(free.pop());
            let leaves = crate::dc::ORDER
                .iter()
                .rev()
                .filter(|port| open.get(**port) == Some(&true));
            free.extend(leaves.map(|port| (number, *port)));
        }
        Self {
            ports: ports.to_vec(),
            parents,
        }
    }

    /// A line of so many slaves.
    #[must_use]
    pub fn line(count: usize) -> Self {
        let ports: Vec<_> = (0..count)
            .map(|number| [true, number + 1 < count, false, false])
            .collect();
        Self::new(&ports)
    }

    /// The slave and the port that a slave hangs on; `None` for the first, which hangs on the master.
    #[must_use]
    pub fn parent(&self, number: usize) -> Option<(usize, usize)> {
        self.parents.get(number).copied().flatten()
    }

    /// Which of its ports are open.
    #[must_use]
    pub fn ports(&self, number: usize) -> [bool; 4] {
        self.ports.get(number).copied().unwrap_or_default()
    }

    /// Whether a slave hangs on a port of another. An open port without one leads back to the master, as at the end of
    /// a ring of two ports.
    #[must_use]
    pub fn has_child(&self, number: usize, port: usize) -> bool {
        self.parents.contains(&Some((number, port)))
    }

    /// How many slaves there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.ports.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.ports.is_empty()
    }

    /// Whether a slave hangs on another, directly or not.
    #[must_use]
    pub fn is_behind(&self, number: usize, other: usize) -> bool {
        let mut at = number;
        while let Some((parent, _)) = self.parent(at) {
            if parent == other {
                return true;
            }
            at = parent;
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_a_line() {
        let line = Topology::line(3);
        let parents: Vec<_> = (0..4).map(|number| line.parent(number)).collect();
        assert_eq!(parents, [None, Some((0, 1)), Some((1, 1)), None]);
        assert!(line.is_behind(2, 0) && !line.is_behind(0, 2) && !line.is_behind(1, 1));
    }

    #[test]
    fn branches_are_passed_in_the_order_of_the_ports() {
        // 0 has a line of two at port 3, one at port 1, one at port 2.
        let tree = Topology::new(&[
            [true, true, true, true],
            [true, true, false, false],
            [true, false, false, false],
            [true, false, false, false],
            [true, false, false, false],
        ]);
        let parents: Vec<_> = (0..5).map(|number| tree.parent(number)).collect();
        assert_eq!(
            parents,
            [None, Some((0, 3)), Some((1, 1)), Some((0, 1)), Some((0, 2))]
        );
        assert!(tree.is_behind(2, 0) && !tree.is_behind(3, 1));
        assert_eq!((tree.len(), tree.is_empty()), (5, false));
    }
}
