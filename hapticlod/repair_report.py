"""What cleaning a scan found, and what it mended."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any


@dataclass(frozen=True)
class Count:
    """How often a defect was found, and in how many of those places it was mended."""

    found: int = 0
    fixed: int = 0


@dataclass(frozen=True)
class RepairReport:
    """What cleaning met. Faces and vertices count as in the file; edges as they are after the mesh is welded.

    Attributes:
        triangles_read, vertices_read: in the file.
        triangles, vertices, components, closed_components: in the cleaned mesh.
        weld_tolerance_mm: border vertices nearer than this became one; 0 where the mesh has no border.
        not_finite_vertices: NaN or infinite; fixed = dropped, with the faces_on_not_finite that used them.
        equal_vertices, near_vertices: copies of another vertex, and border vertices within the tolerance of another.
        unused_vertices: vertices that no face of the file uses.
        degenerate_faces: faces without area; dropped, or mended by flipping their longest edge.
        duplicate_faces: faces over the same three vertices as another, whichever way they run.
        inconsistent_edges: edges whose two faces run the same way; fixed by turning `turned_faces` faces.
        inside_out_components: closed components whose faces point inward; fixed = turned outward, the others lie
            inside another component and stay, as walls of cavities.
        boundary_edges, non_manifold_edges: edges with one face, and with more than two; kept as they are.
        notes: other things worth knowing, one sentence each.
    """

    triangles_read: int
    vertices_read: int
    triangles: int
    vertices: int
    components: int
    closed_components: int
    weld_tolerance_mm: float
    turned_faces: int
    not_finite_vertices: Count
    faces_on_not_finite: Count
    equal_vertices: Count
    near_vertices: Count
    unused_vertices: Count
    degenerate_faces: Count
    duplicate_faces: Count
    inconsistent_edges: Count
    inside_out_components: Count
    boundary_edges: Count
    non_manifold_edges: Count
    notes: tuple[str, ...] = ()

    def counts(self) -> dict[str, Count]:
        """Every defect by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if isinstance(getattr(self, f.name), Count)}

    def repaired(self) -> dict[str, int]:
        """Defects that changed the shape or its faces, with how often; sharing equal vertices changes neither."""
        harmless = {"equal_vertices", "unused_vertices"}
        return {name: count.fixed for name, count in self.counts().items() if count.fixed and name not in harmless}

    def lines(self) -> list[str]:
        """The report for people, one line per fact, defects that did not occur left out."""
        closed = f", {self.closed_components} closed" if self.closed_components else ""
        parts = f"{self.components} component{'s' if self.components != 1 else ''}{closed}"
        text = [
            f"{self.triangles} triangles, {self.vertices} vertices, {parts} (read: {self.triangles_read} triangles)"
        ]
        for name, count in self.counts().items():
            if count.found:
                done = {0: "kept", count.found: "fixed"}.get(count.fixed, f"{count.fixed} fixed")
                text.append(f"{name.replace('_', ' ')}: {count.found} found, {done}")
        if self.turned_faces:
            text.append(f"faces turned: {self.turned_faces}")
        if self.near_vertices.found:
            text.append(f"weld tolerance: {self.weld_tolerance_mm * 1000:.3g} um")
        return text + list(self.notes)

    def to_dict(self) -> dict[str, Any]:
        """The report as plain JSON values: every defect is {"found": int, "fixed": int}."""
        return asdict(self)
