//! The topology of a segment: the tree follows from the open ports of the slaves, as frames pass ports in the order 0,
//! 3, 1, 2 (ETG.1000.4). Bad cables are located elsewhere.

/// The tree of a segment; slaves are numbered by their position in the ring.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Topology {
    ports: Vec<[bool; 4]>,
    /// Parent slave and port of each slave.
    parents: Vec<Option<(usize, usize)>>,
}

impl Topology {
    /// From the open ports of the slaves, by position in the ring. A slave for which no port is left has no parent.
    pub fn new(ports: &[[bool; 4]]) -> Self {
        let mut parents = Vec::with_capacity(ports.len());
        // Ports that frames have yet to leave by, the nearest last.
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

    /// A line of `count` slaves.
    pub fn line(count: usize) -> Self {
        let ports: Vec<_> = (0..count)
            .map(|number| [true, number + 1 < count, false, false])
            .collect();
        Self::new(&ports)
    }

    /// Parent slave and port of a slave; `None` for the first, which is connected to the master.
    pub fn parent(&self, number: usize) -> Option<(usize, usize)> {
        self.parents.get(number).copied().flatten()
    }

    /// The open ports of a slave.
    pub fn ports(&self, number: usize) -> [bool; 4] {
        self.ports.get(number).copied().unwrap_or_default()
    }

    /// Whether a slave is connected to a port of another. An open port without a slave leads back to the master, as at
    /// the end of a ring of two ports.
    pub(crate) fn has_child(&self, number: usize, port: usize) -> bool {
        self.parents.contains(&Some((number, port)))
    }

    /// Number of slaves.
    pub fn len(&self) -> usize {
        self.ports.len()
    }

    /// Whether the segment is empty.
    pub fn is_empty(&self) -> bool {
        self.ports.is_empty()
    }

    /// Whether a slave is behind another, directly or indirectly.
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
    fn line_topology_has_consecutive_parents() {
        let line = Topology::line(3);
        let parents: Vec<_> = (0..4).map(|number| line.parent(number)).collect();
        assert_eq!(parents, [None, Some((0, 1)), Some((1, 1)), None]);
        assert!(line.is_behind(2, 0) && !line.is_behind(0, 2) && !line.is_behind(1, 1));
    }

    #[test]
    fn branches_follow_the_port_order() {
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
