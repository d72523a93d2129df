//! Which faces each vertex has, in one piece of memory, while they change.

/// Faces of each vertex.
pub struct Fans {
    /// Where those of a vertex begin, how many there are, and how many there is room for.
    place: Vec<(u32, u32, u32)>,
    faces: Vec<u16>,
}

impl Fans {
    /// Of these faces.
    pub fn new(vertices: usize, faces: &[[u16; 3]]) -> Self {
        let mut place = vec![(0, 0, 0); vertices];
        faces.iter().flatten().for_each(|v| place[usize::from(*v)].2 += 1);
        let mut room = 0;
        for p in &mut place {
            // Half as many again, as a vertex takes on those of another.
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

    /// Those of a vertex.
    pub fn get(&self, v: u16) -> &[u16] {
        let (first, count, _) = self.place[usize::from(v)];
        &self.faces[first as usize..][..count as usize]
    }

    /// Adds a face to a vertex.
    pub fn push(&mut self, v: u16, face: u16) {
        let (first, count, room) = self.place[usize::from(v)];
        let mut to = first as usize;
        if count == room {
            // Moves to the end.
            to = self.faces.len();
            self.faces.extend_from_within(first as usize..(first + count) as usize);
            self.faces.resize(to + 2 * count as usize + 4, 0);
            self.place[usize::from(v)] = (to as u32, count, 2 * count + 4);
        }
        self.faces[to + count as usize] = face;
        self.place[usize::from(v)].1 += 1;
    }

    /// Takes a face from a vertex; the others stay in order.
    pub fn remove(&mut self, v: u16, face: u16) {
        let (first, count, _) = self.place[usize::from(v)];
        let own = &mut self.faces[first as usize..][..count as usize];
        if let Some(i) = own.iter().position(|f| *f == face) {
            own.copy_within(i + 1.., i);
            self.place[usize::from(v)].1 -= 1;
        }
    }

    /// Leaves a vertex none. Where they were: [`Self::at`] tells them until the next is taken.
    pub fn take(&mut self, v: u16) -> std::ops::Range<usize> {
        let p = &mut self.place[usize::from(v)];
        let count = std::mem::take(&mut p.1);
        p.0 as usize..(p.0 + count) as usize
    }

    /// The face at a place.
    pub fn at(&self, place: usize) -> u16 {
        self.faces[place]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vertex_keeps_its_faces_in_order_however_many_it_takes_on() {
        let mut fans = Fans::new(4, &[[0, 1, 2], [0, 2, 3], [1, 3, 2]]);
        assert_eq!(
            [0, 1, 2, 3].map(|v| fans.get(v).to_vec()),
            [vec![0, 1], vec![0, 2], vec![0, 1, 2], vec![1, 2]]
        );
        (10..40).for_each(|f| fans.push(0, f));
        fans.remove(0, 1);
        fans.remove(0, 77);
        let wanted: Vec<u16> = [0].into_iter().chain(10..40).collect();
        assert_eq!(fans.get(0), wanted);
        assert_eq!(fans.get(1), [0, 2]);
        let places = fans.take(2);
        assert!(fans.get(2).is_empty());
        fans.push(3, 9);
        assert_eq!(places.map(|i| fans.at(i)).collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!(fans.get(3), [1, 2, 9]);
    }
}
