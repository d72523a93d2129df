//! Incident faces of each vertex, in one allocation, while faces change.

/// Incident faces of each vertex.
pub struct VertexFaces {
    /// First entry, number of entries and capacity of each vertex.
    place: Vec<(u32, u32, u32)>,
    faces: Vec<u16>,
}

impl VertexFaces {
    /// Builds the lists.
    pub fn new(vertices: usize, faces: &[[u16; 3]]) -> Self {
        let mut place = vec![(0, 0, 0); vertices];
        faces.iter().flatten().for_each(|v| place[usize::from(*v)].2 += 1);
        let mut room = 0;
        for p in &mut place {
            // Half as many again: a collapse adds the faces of another vertex.
            p.2 += p.2 / 2;
            p.0 = room;
            room += p.2;
        }
        let mut this = Self { place, faces: vec![0; room as usize] };
        for (f, i) in faces.iter().zip(0..) {
            f.iter().for_each(|v| this.push(*v, i));
        }
        this
    }

    /// Faces of a vertex.
    pub fn get(&self, v: u16) -> &[u16] {
        let (first, count, _) = self.place[usize::from(v)];
        &self.faces[first as usize..][..count as usize]
    }

    /// Adds a face to a vertex.
    pub fn push(&mut self, v: u16, face: u16) {
        let (first, count, room) = self.place[usize::from(v)];
        let mut to = first as usize;
        if count == room {
            // Full: the list moves to the end with twice the capacity.
            to = self.faces.len();
            self.faces.extend_from_within(first as usize..(first + count) as usize);
            self.faces.resize(to + 2 * count as usize + 4, 0);
            self.place[usize::from(v)] = (to as u32, count, 2 * count + 4);
        }
        self.faces[to + count as usize] = face;
        self.place[usize::from(v)].1 += 1;
    }

    /// Removes a face from a vertex; the others stay in order.
    pub fn remove(&mut self, v: u16, face: u16) {
        let (first, count, _) = self.place[usize::from(v)];
        let own = &mut self.faces[first as usize..][..count as usize];
        if let Some(i) = own.iter().position(|f| *f == face) {
            own.copy_within(i + 1.., i);
            self.place[usize::from(v)].1 -= 1;
        }
    }

    /// Empties the list of a vertex; returns the range of its entries, which [`Self::face`] reads
    /// until a list grows past its capacity.
    pub fn clear(&mut self, v: u16) -> std::ops::Range<usize> {
        let p = &mut self.place[usize::from(v)];
        let count = std::mem::take(&mut p.1);
        p.0 as usize..(p.0 + count) as usize
    }

    /// The face at an entry.
    pub fn face(&self, place: usize) -> u16 {
        self.faces[place]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn incident_faces_keep_their_order_while_lists_grow_and_shrink() {
        let mut faces_of = VertexFaces::new(4, &[[0, 1, 2], [0, 2, 3], [1, 3, 2]]);
        assert_eq!(
            [0, 1, 2, 3].map(|v| faces_of.get(v).to_vec()),
            [vec![0, 1], vec![0, 2], vec![0, 1, 2], vec![1, 2]]
        );
        (10..40).for_each(|f| faces_of.push(0, f));
        faces_of.remove(0, 1);
        faces_of.remove(0, 77);
        let wanted: Vec<u16> = [0].into_iter().chain(10..40).collect();
        assert_eq!(faces_of.get(0), wanted);
        assert_eq!(faces_of.get(1), [0, 2]);
        let places = faces_of.clear(2);
        assert!(faces_of.get(2).is_empty());
        faces_of.push(3, 9);
        assert_eq!(places.map(|i| faces_of.face(i)).collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!(faces_of.get(3), [1, 2, 9]);
    }
}
