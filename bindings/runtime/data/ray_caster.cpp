// SPDX-FileCopyrightText: The sweepkit authors
// SPDX-License-Identifier: Apache-2.0
#include "ray_caster.hpp"

#include <algorithm>
#include <cstring>
#include <string>
#include <vector>

#include "sweepkit/core/error.hpp"

namespace sweepkit {
namespace {

// Bits of Embree's masks: all surfaces are seen, not all cast shadows.
constexpr unsigned kSeen = 1, kShadow = 2;

void copy_in(const RayCaster::Rays& rays, RTCRay8& ray, unsigned mask) {
  std::memcpy(ray.org_x, rays.ox, sizeof(rays.ox));
  std::memcpy(ray.org_y, rays.oy, sizeof(rays.oy));
  std::memcpy(ray.org_z, rays.oz, sizeof(rays.oz));
  std::memcpy(ray.dir_x, rays.dx, sizeof(rays.dx));
  std::memcpy(ray.dir_y, rays.dy, sizeof(rays.dy));
  std::memcpy(ray.dir_z, rays.dz, sizeof(rays.dz));
  std::memcpy(ray.tfar, rays.far, sizeof(rays.far));
  std::fill_n(ray.tnear, RayCaster::kPacket, rays.near);
  std::fill_n(ray.time, RayCaster::kPacket, 0.0f);
  std::fill_n(ray.mask, RayCaster::kPacket, mask);
  std::fill_n(ray.flags, RayCaster::kPacket, 0u);
}

}  // namespace

RayCaster::RayCaster(const SurfaceMesh& mesh) {
  device_ = rtcNewDevice("threads=1,set_affinity=0");
  if (!device_) throw Error(ErrorKind::io, "Renderer", "Embree does not start on this machine");
  scene_ = rtcNewScene(device_);
  rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
  // One geometry for what casts shadows, one for what does not; the triangle's number in the mesh is kept by
  // ordering: user data cannot be had from a hit without a call.
  for (const unsigned id : {0u, 1u}) {
    RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertices = static_cast<float*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float),
                                std::max<std::size_t>(mesh.vertices.size(), 1)));
    auto* indices = static_cast<unsigned*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(unsigned),
                                std::max<std::size_t>(mesh.triangles.size(), 1)));
    if (!vertices || !indices) throw Error(ErrorKind::io, "Renderer", "no memory for the scene's triangles");
    std::memcpy(vertices, mesh.vertices.data(), mesh.vertices.size() * sizeof(MeshVertex));
    for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
      const auto& t = mesh.triangles[i];
      // Triangles of the other kind shrink to a point, which no ray hits.
      const bool mine = mesh.patches[t.patch].shadow == (id == 0);
      for (int k = 0; k < 3; ++k)
        indices[3 * i + static_cast<std::size_t>(k)] = mine ? t.vertex[k] : t.vertex[0];
    }
    rtcSetGeometryMask(geometry, id == 0 ? kSeen | kShadow : kSeen);
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(scene_, geometry, id);
    rtcReleaseGeometry(geometry);
  }
  rtcCommitScene(scene_);
}

RayCaster::~RayCaster() {
  if (scene_) rtcReleaseScene(scene_);
  if (device_) rtcReleaseDevice(device_);
}

void RayCaster::intersect(Rays& rays, bool coherent) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  if (coherent) context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  RTCRayHit8 hit;
  copy_in(rays, hit.ray, kSeen);
  std::fill_n(hit.hit.geomID, kPacket, RTC_INVALID_GEOMETRY_ID);
  std::fill_n(hit.hit.instID[0], kPacket, RTC_INVALID_GEOMETRY_ID);
  alignas(32) int valid[kPacket];
  std::memcpy(valid, rays.valid, sizeof(valid));
  rtcIntersect8(valid, scene_, &context, &hit);
  for (int i = 0; i < kPacket; ++i) {
    const bool found = rays.valid[i] && hit.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID;
    rays.triangle[i] = found ? hit.hit.primID[i] : kNone;
    rays.far[i] = hit.ray.tfar[i];
  }
}

void RayCaster::occlude(Rays& rays, bool coherent) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  if (coherent) context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  RTCRay8 ray;
  copy_in(rays, ray, kShadow);
  alignas(32) int valid[kPacket];
  std::memcpy(valid, rays.valid, sizeof(valid));
  rtcOccluded8(valid, scene_, &context, &ray);
  std::memcpy(rays.far, ray.tfar, sizeof(rays.far));
}

}  // namespace sweepkit
