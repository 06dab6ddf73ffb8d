"""From pair edges to scan poses: Open3D's pose graph with line process, and GTSAM's GNC."""

from __future__ import annotations

from collections.abc import Mapping

import gtsam
import networkx as nx
import numpy as np

from benchmark.methods.clouds import ICP_DISTANCES_M, registration
from benchmark.methods.interface import Candidate
from fewview.geometry import se3
from fewview.types import Array

Edges = Mapping[tuple[int, int], Candidate]
"""(source, target) -> edge; its score counts inliers, overlap and information are known."""
ROTATION_SIGMA, TRANSLATION_SIGMA_M = 0.03, 0.05
FIRM_SCORE = 100
"""Edges with fewer inliers than this are believed less, by the square root of the ratio."""
PRIOR_SIGMA = 1e-4


def robust_rec(scans: list[int], edges: Edges) -> dict[int, Array]:
    """world_T_scan of connected scans (Choi et al. 2015 as Open3D has it).

    The maximum spanning tree by overlap holds the certain edges; it also gives the first guess.
    """
    tree = _spanning_tree(scans, edges)
    start = _chained(tree, edges, scans[0])
    graph = registration.PoseGraph()
    for scan in scans:
        graph.nodes.append(registration.PoseGraphNode(start[scan]))
    node = {scan: i for i, scan in enumerate(scans)}
    for (source, target), edge in edges.items():
        graph.edges.append(
            registration.PoseGraphEdge(
                node[source],
                node[target],
                edge.target_T_source,
                edge.information,
                uncertain=not tree.has_edge(source, target),
            )
        )
    registration.global_optimization(
        graph,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        registration.GlobalOptimizationOption(
            max_correspondence_distance=ICP_DISTANCES_M[-1],
            edge_prune_threshold=0.25,
            reference_node=0,
        ),
    )
    return {scan: np.array(graph.nodes[i].pose) for scan, i in node.items()}


def gnc(scans: list[int], edges: Edges) -> dict[int, Array]:
    """world_T_scan of connected scans by graduated non-convexity with truncated least squares."""
    start = _chained(_spanning_tree(scans, edges), edges, scans[0])
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    prior = gtsam.noiseModel.Isotropic.Sigma(6, PRIOR_SIGMA)
    graph.add(gtsam.PriorFactorPose3(scans[0], gtsam.Pose3(start[scans[0]]), prior))
    sigmas = np.array([ROTATION_SIGMA] * 3 + [TRANSLATION_SIGMA_M] * 3)
    for (source, target), edge in edges.items():
        measured = gtsam.Pose3(edge.target_T_source)
        looseness = np.sqrt(max(1.0, FIRM_SCORE / max(edge.score, 1)))
        noise = gtsam.noiseModel.Diagonal.Sigmas(looseness * sigmas)
        graph.add(gtsam.BetweenFactorPose3(target, source, measured, noise))
    for scan in scans:
        values.insert(scan, gtsam.Pose3(start[scan]))
    parameters = gtsam.GncLMParams(gtsam.LevenbergMarquardtParams())
    parameters.setLossType(gtsam.GncLossType.TLS)
    parameters.setKnownInliers([0])
    solved = gtsam.GncLMOptimizer(graph, values, parameters).optimize()
    return {scan: solved.atPose3(scan).matrix() for scan in scans}


def _spanning_tree(scans: list[int], edges: Edges) -> nx.Graph:
    graph = nx.Graph()
    graph.add_nodes_from(scans)
    for (source, target), edge in edges.items():
        graph.add_edge(source, target, weight=edge.overlap)
    return nx.maximum_spanning_tree(graph)


def _chained(tree: nx.Graph, edges: Edges, root: int) -> dict[int, Array]:
    poses = {root: np.eye(4)}
    for parent, child in nx.bfs_edges(tree, root):
        if (child, parent) in edges:
            parent_T_child = edges[child, parent].target_T_source
        else:
            parent_T_child = se3.inverse(edges[parent, child].target_T_source)
        poses[child] = poses[parent] @ parent_T_child
    return poses
